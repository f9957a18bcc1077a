import numpy as np
import pytest

from echoavatar_lab.corpora.speech.script import templates, write_monologue, write_sentence


def sentences(split: str, count: int = 400):
    rng = np.random.default_rng(3)
    return [write_sentence(rng, split) for _ in range(count)]


def test_most_sentences_are_different():
    texts = {s.text for s in sentences("train")}
    assert len(texts) > 0.75 * 400


def test_train_and_test_share_no_template():
    train, test = ({t for shape in templates(split) for t in shape} for split in ("train", "test"))
    assert not train & test
    assert len(test) >= 10
    assert {s.template for s in sentences("test")} <= test
    assert {s.template for s in sentences("train")} <= train


@pytest.mark.parametrize("split", ["train", "test"])
def test_no_markup_is_left_in_the_words(split):
    for sentence in sentences(split):
        assert sentence.words
        for word in sentence.words:
            assert word.text.isalpha(), sentence
            assert word.mark in ("", ",", ".", "?")


def test_focus_and_every_meaning_occur():
    words = [w for split in ("train", "test") for s in sentences(split) for w in s.words]
    assert {"size", "deixis", "negation", "count", "contrast", "question", "greeting"} <= {w.meaning for w in words}
    assert 0.02 < np.mean([w.is_focus for w in words]) < 0.3
    assert any(w.pause for w in words)


def test_a_monologue_does_not_repeat_a_shape_at_once():
    lines = write_monologue(np.random.default_rng(1), 30)
    assert all(a.template != b.template for a, b in zip(lines, lines[1:], strict=False))
