import re

from echoavatar_lab.corpora.speech.vocabulary import PHRASES, SENTENCES, WORDS


def test_every_slot_of_every_template_exists():
    every = [t for group in (*SENTENCES.values(), *PHRASES.values()) for t in group]
    for template in every:
        for slot in re.findall(r"\{(\w+)\}", template):
            assert slot in WORDS or slot in PHRASES, template


def test_templates_are_unique_so_that_a_split_is_a_split():
    every = [t for group in SENTENCES.values() for t in group]
    assert len(every) == len(set(every))


def test_words_are_plain_and_not_listed_twice():
    for words in WORDS.values():
        assert len(words) == len(set(words))
        assert all(word.isalpha() for word in words)
