"""Checks, speed and straight answers, by hand."""

import pytest

from echoavatar_studio.answers import AnswerRecord
from echoavatar_studio.quality import _straight, is_too_fast, passes


def answer(**changes) -> AnswerRecord:
    usual = {
        "rater": 1, "is_excluded": False, "trial": 1, "role": "real", "sound": "a", "category": "dance",
        "systems": ("A", "B"), "ratings": {"overall_preference": 1}, "best": None, "worst": None, "skipped": None,
        "order": (0, 1), "first": 0, "seconds": 20.0, "clip_seconds": 10.0, "plays": (1, 1), "at": 0.0,
    }  # fmt: skip
    return AnswerRecord(**(usual | changes))


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({}, None),
        ({"role": "training"}, None),
        ({"role": "identical", "ratings": {"overall_preference": 1, "beat_matching": 0}}, True),
        ({"role": "identical", "ratings": {"overall_preference": 0, "beat_matching": -2}}, False),
        ({"role": "identical", "ratings": {}, "skipped": "cannot_play"}, False),
        ({"role": "corrupted"}, True),
        ({"role": "corrupted", "ratings": {"overall_preference": 0}}, False),
        ({"role": "corrupted", "ratings": {"overall_preference": -1}}, False),
        ({"role": "corrupted", "ratings": {}, "best": 0, "worst": 2, "order": (2, 0, 1)}, True),
        ({"role": "corrupted", "ratings": {}, "best": 2, "worst": 0, "order": (2, 0, 1)}, False),
        ({"role": "corrupted", "ratings": {}, "skipped": "no_difference", "order": (2, 0, 1)}, False),
    ],
)
def test_attention_checks(changes, wanted):
    assert passes(answer(**changes)) is wanted


def test_an_answer_in_less_time_than_a_clip_lasts_is_too_fast():
    assert is_too_fast(answer(seconds=9.9))
    assert not is_too_fast(answer(seconds=10.1))


def test_straight_answers_are_seen_as_on_the_screen():
    """Always the right side by one: towards the first system the sign changes with the order, on screen it does not."""
    same = [answer(order=(0, 1), ratings={"overall_preference": -1}), answer(order=(1, 0))]
    assert _straight(same) == 1.0
    assert _straight([answer(), answer(ratings={"overall_preference": 2})]) == 0.5
    assert _straight([answer(role="training")]) == 0.0
