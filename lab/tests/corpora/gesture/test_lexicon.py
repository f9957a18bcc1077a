import numpy as np
import pytest

from echoavatar.models.generator.manner import Manner
from echoavatar_lab.corpora.gesture.handpath import FINGERS, WRIST
from echoavatar_lab.corpora.gesture.lexicon import (
    ACCENTS,
    HOME,
    MEANINGS,
    aim_at,
    eased_reach,
    home_of,
    in_gesture_space,
    meant_form,
)

TAGS = ("size", "deixis", "negation", "count", "contrast", "question", "greeting")


@pytest.mark.parametrize("tag", TAGS)
def test_every_meaning_has_a_form(tag: str):
    assert meant_form(tag, "word") in MEANINGS


def test_words_choose_among_forms():
    assert meant_form("size", "tiny") == "small"
    assert meant_form("size", "Huge,") == "size"
    assert [meant_form("deixis", word) for word in ("we", "you", "this", "over")] == ["me", "you", "here", "there"]


@pytest.mark.parametrize("form", [*ACCENTS.values(), *MEANINGS.values()], ids=[*ACCENTS, *MEANINGS])
def test_aims_are_within_an_arms_reach(form):
    rng = np.random.default_rng(0)
    for _ in range(10):
        aim = aim_at(form, home_of(Manner(space=1.0), rng), size=1.8, rng=rng)
        assert np.linalg.norm(aim[WRIST]) < 0.56
        assert np.abs(aim[FINGERS]).max() < 1.2


def test_home_varies_about_its_place():
    rng = np.random.default_rng(1)
    homes = np.stack([home_of(Manner(), rng)[WRIST] for _ in range(200)])
    np.testing.assert_allclose(homes.mean(axis=0), HOME, atol=0.02)
    assert homes.std(axis=0).min() > 0.01


def test_far_aims_are_drawn_in_and_near_ones_kept():
    np.testing.assert_allclose(eased_reach(np.array([0.0, 0.0, 0.53], np.float32)), [0, 0, 0.47], atol=1e-6)
    np.testing.assert_allclose(eased_reach(np.array([0.0, 0.3, 0.2], np.float32)), [0, 0.3, 0.2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(eased_reach(np.array([0.0, 0.1, 0.0], np.float32))), 0.25, atol=1e-6)


def test_hands_do_not_hide_the_face():
    """A high aim across the middle comes back to its own side; a low one may cross."""
    assert in_gesture_space(np.array([-0.2, 0.1, 0.25]))[0] > -0.02
    assert in_gesture_space(np.array([-0.2, -0.3, 0.25]))[0] < -0.08
