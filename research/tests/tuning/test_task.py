"""Prompts are of both kinds of sound alike, and people's windows come from both."""

import numpy as np
import pytest
from tests.align.tuning import clips
from tests.evaluation.test_alive import swaying

from echoavatar.errors import MotionError
from echoavatar.evaluation.alive import Take
from echoavatar_research.tuning.judge import kind_of
from echoavatar_research.tuning.task import PromptsByKind, people_in_music


def book(kinds: tuple[int, ...]) -> PromptsByKind:
    made = clips(len(kinds), 12)
    for kind, clip in zip(kinds, made.values(), strict=True):
        object.__setattr__(clip, "domain", np.full_like(clip.domain, kind))
    return PromptsByKind(made, past=2, length=4)


def test_half_is_music_and_three_eighths_are_speech() -> None:
    drawn = book((1, 2, 2, 2, 2, 0)).draw(3, 16)
    assert [kind_of(prompt) for prompt in drawn[:14]] == ["music"] * 8 + ["speech"] * 6
    assert len(drawn) == 16
    again = book((1, 2, 2, 2, 2, 0)).draw(3, 16)
    assert [(one.clip, one.start) for one in drawn] == [(one.clip, one.start) for one in again]


def test_one_kind_of_sound_is_not_enough() -> None:
    with pytest.raises(MotionError, match="filled with speech"):
        book((2, 2)).draw(0, 16)


def test_people_in_music_are_the_captured_dancers() -> None:
    takes = [Take("a", "music", "", swaying(400)), Take("b", "speech", "", swaying(400))]
    rows = people_in_music(takes, length=28)
    assert rows.shape == (1 + (400 - 224) // 45, 9)
    with pytest.raises(MotionError, match="no dance that lasts"):
        people_in_music(takes[1:], length=28)
