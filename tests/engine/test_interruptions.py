"""The default bundle, interrupted at random while its source runs ten times ahead of the player.

A player shows motion at its own pace. Speech comes ten times as fast, so that motion is made ahead of it; at a random
sample all that was not heard is taken back, and silence follows. A witness hears, in one go, only what was heard. Its
motion is what must be shown once the blend out of the pose on screen has died away: a frame that stemmed from unheard
sound would differ. (Frames before the cut may: of its chunk they were shown before its end was taken back.) Times are
those of the motion; they do not depend on how busy the machine is.
"""

import logging
import time
from typing import NamedTuple

import numpy as np
import pytest
import soundfile
from tests.engine.test_barge_in import Player

import echoavatar
from echoavatar.engine import Engine, Session, SessionCore
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.playout import first_frame_after
from echoavatar.motion.motion_chunk import join
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

_log = logging.getLogger(__name__)
FASTER = 10  # than real time
BEAT = 2_400  # samples of playback between two looks
AHEAD = 7  # chunks, what the server allows
SAME_DEG = 0.05


class Cut(NamedTuple):
    """One interruption."""

    heard: int  # samples
    unheard_s: float  # of motion that was made and taken back
    answer_s: float  # processor time until the first new motion was there


class Talk:
    """One session, its player, and what was really heard."""

    def __init__(self, pipeline: Pipeline, seed: int) -> None:
        self.engine = Engine(pipeline, look_ahead=AHEAD)
        self.session = self.engine.open_core(seed=seed)
        self.player = Player(self.session)
        self.random = np.random.default_rng(seed)
        self.truth = np.zeros(0, np.float32)
        self.at = 0  # what the player has shown
        self.cuts: list[Cut] = []

    def say_and_cut(self, speech: np.ndarray) -> None:
        start = int(self.random.integers(0, len(speech) - 20 * SAMPLE_RATE_HZ))
        self._silence()
        end = self.at + int(self.random.uniform(0.3, 1.2) * SAMPLE_RATE_HZ)
        while self.at < end:
            self._push(speech[start : start + FASTER * BEAT])
            start += FASTER * BEAT
            self._play(min(BEAT, end - self.at))
        made, before = self.session.made, time.process_time()
        assert self.session.interrupt(self.at).at == first_frame_after(self.at) * SAMPLES_PER_FRAME
        while not self.player.read():  # twice, where no frame of the chunk that was cut is left
            self.session.stall()
            self.engine.tick()
        self.cuts.append(Cut(self.at, (made - self.at) / SAMPLE_RATE_HZ, time.process_time() - before))
        self.truth = np.pad(self.truth[: self.at], (0, self.session.made - self.at))
        self._silence()

    def _silence(self) -> None:
        self._push(np.zeros(-len(self.truth) % CHUNK_SAMPLES + CHUNK_SAMPLES, np.float32))
        self._play(len(self.truth) - self.at)

    def _push(self, sound: np.ndarray) -> None:
        self.truth = np.concatenate([self.truth, sound])
        self.session.push(sound)

    def _play(self, samples: int) -> None:
        self.at += samples
        self.session.report_played(self.at)
        while self.session.is_ready:
            self.engine.tick()
        self.player.read()

    def shown(self) -> np.ndarray:
        return np.stack([self.player.rotations[at] for at in range(len(self.player.rotations))])


def witness(pipeline: Pipeline, truth: np.ndarray, seed: int) -> np.ndarray:
    session: SessionCore = Engine(pipeline, rewind=0).open_core(seed=seed)
    session.push(truth)
    return join(list(Session(session))).rotations


def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between two rotations; by the sine of the half, as small angles vanish in the cosine."""
    far = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return np.degrees(4 * np.arcsin(np.clip(far / 2, 0, 1)))


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return Pipeline(load_bundle("default"))


@pytest.mark.parametrize("cuts", [2, pytest.param(200, marks=pytest.mark.slow)])
def test_speaking_motion_ends_at_once_and_without_a_jerk(pipeline: Pipeline, cuts: int) -> None:
    speech = soundfile.read(f"{echoavatar.__path__[0]}/assets/speech.ogg", dtype="float32")[0]
    speech = np.concatenate([speech, speech])
    talk = Talk(pipeline, seed=3)
    for _ in range(cuts):
        talk.say_and_cut(speech)
    shown, true = talk.shown(), witness(pipeline, talk.truth, seed=3)
    assert len(shown) == len(true)
    off = degrees(shown, true).max(1)
    speed = degrees(shown[1:], shown[:-1]).max(1) * FRAME_RATE_HZ
    borders = [cut.heard // CHUNK_SAMPLES * CHUNK_FRAMES for cut in talk.cuts]
    ends, fastest = [], []
    for cut, after in zip(talk.cuts, [*borders[1:], len(shown)], strict=True):
        first = first_frame_after(cut.heard)
        blended = np.flatnonzero(off[first:after] > SAME_DEG)
        last = first + (blended.max() + 1 if len(blended) else 0)
        ends.append(last / FRAME_RATE_HZ - cut.heard / SAMPLE_RATE_HZ)
        fastest.append(speed[max(0, first - 1) : last + 1].max())
    answers, unheard = [cut.answer_s for cut in talk.cuts], [cut.unheard_s for cut in talk.cuts]
    _log.info("%d cuts, %.2f s made ahead of each", cuts, np.mean(unheard))
    _log.info("motion of unheard sound gone after (s): p50 %.3f, worst %.3f", np.median(ends), max(ends))
    _log.info("first new motion after (processor s): p50 %.3f, worst %.3f", np.median(answers), max(answers))
    _log.info("fastest joint in a blend %.0f deg/s, elsewhere %.0f", max(fastest), speed.max())
    assert min(unheard) > 0.5
    assert max(ends) < 0.3
    assert max(fastest) < 1_200
