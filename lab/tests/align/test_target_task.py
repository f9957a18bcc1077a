"""Prompts are of both kinds of sound alike, and people's windows come from both."""

import copy

import numpy as np
import pytest
from lab.tests.align.tuning_fakes import clips
from lab.tests.evaluation.test_alive import swaying
from tests.models.generator.tiny import generator

from echoavatar.errors import MotionError
from echoavatar_lab.align import target_task
from echoavatar_lab.align.target_task import PromptsByKind, TargetTask, people_in_music
from echoavatar_lab.align.targets import TargetJudge, kind_of
from echoavatar_lab.align.trainer import AlignTraining
from echoavatar_lab.evaluation.takes import Take


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


def test_of_a_long_past_of_its_own_the_end_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target_task, "KEPT", 2)
    training = AlignTraining(past=5, own_past=3, length=2, batch=8, group=2, layers=1)
    model = generator(sequence="interleaved")
    made = clips(4, 12)
    for number, clip in enumerate(made.values()):
        object.__setattr__(clip, "domain", np.full_like(clip.domain, 1 + number % 2))
    prompts = PromptsByKind(made, past=5, length=2)
    tuning = TargetTask(model, copy.deepcopy(model), training, TargetJudge(None, {}, {}), book=prompts)
    drawn = prompts.draw(0, 8)
    for before, after in zip(drawn, tuning._with_own_past(drawn, 0), strict=True):
        assert after.start == before.start + 3
        assert len(after.past) == 2 * 2
        np.testing.assert_array_equal(after.audio, before.audio[3 * 20 :])
        again = prompts.cut(after.clip, before.start)
        assert not np.array_equal(after.past, again.past[3 * 2 :])
