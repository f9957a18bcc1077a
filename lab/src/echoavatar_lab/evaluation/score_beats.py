"""Beat alignment of generated motion in every form, with chance levels: the rows `ba_g_...` and `ba_d_...`.

If a clip has domain labels, only onsets in speech and beats in music count. Chance is the same motion with the events
of up to 20 other clips, restricted to the time span of its own events.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import get_args

import numpy as np
import soxr
from jaxtyping import Float, Integer
from scipy.interpolate import CubicSpline

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ

from .behaviour import MUSIC, SPEECH
from .metrics.audio_events import EMAGE_RATE_HZ, music_beats, speech_onsets
from .metrics.beat_alignment import overlapping
from .metrics.chance import Score, chance_per_clip, shuffled_scores
from .metrics.dance_alignment import DANCE_RULES, DanceForm, dance_alignment, dance_beats
from .metrics.gesture_alignment import (
    GESTURE_RULES,
    UPPER_BODY,
    GestureForm,
    gesture_alignment,
    gesture_beats,
    mean_speeds,
)
from .score_row import Row, row_of_means

PARTNERS = 20
DANCE_RATE_HZ = 60  # frame rate that Bailando and AIST++ assume
_Times = Float[np.ndarray, " n"]
_Scores = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class ClipAudio:
    """A clip's audio, and the domain of each frame."""

    audio: Float[np.ndarray, " s"]
    domain: Integer[np.ndarray, " t"]

    @cached_property
    def slow(self) -> Float[np.ndarray, " s"]:
        """The audio at EMAGE's 16 kHz."""
        return np.asarray(soxr.resample(self.audio, SAMPLE_RATE_HZ, EMAGE_RATE_HZ))

    def onsets(self, trimmed_frames: int) -> _Times:
        """Onsets in speech, from the trimmed start on; the detector gets only the audio between the cuts."""
        off = trimmed_frames * EMAGE_RATE_HZ // FRAME_RATE_HZ
        inside = self.slow[off : len(self.slow) - off]
        if not (self.domain == SPEECH).any() or len(inside) < EMAGE_RATE_HZ // 2:
            return np.zeros(0)
        times = speech_onsets(inside, EMAGE_RATE_HZ)
        return np.asarray(times[self.falls_on(times + trimmed_frames / FRAME_RATE_HZ, SPEECH)])

    def beats(self) -> _Times:
        """Beats in music."""
        if not (self.domain == MUSIC).any():
            return np.zeros(0)
        times = music_beats(self.audio, SAMPLE_RATE_HZ)
        return np.asarray(times[self.falls_on(times, MUSIC)])

    def falls_on(self, times: _Times, kind: int) -> np.ndarray:
        """Which of these times lie in that domain."""
        frames = np.clip((times * FRAME_RATE_HZ).astype(int), 0, len(self.domain) - 1)
        return np.asarray(self.domain[frames] == kind)


def gesture_rows(
    heard: Sequence[ClipAudio],
    made: Sequence[Float[np.ndarray, "_ j 3"]],
    true: Sequence[Float[np.ndarray, "_ j 3"]],
    *,
    upper: Sequence[int] | None = None,
    seed: int = 0,
) -> list[Row]:
    """BA_G in all forms, over clips with speech; empty if no clip has any.

    `upper` are the numbers of the joints to score; None: the upper body of our rig.
    """
    if not any((clip.domain == SPEECH).any() for clip in heard):
        return []
    upper = HUMANOID.indices(UPPER_BODY) if upper is None else list(upper)
    made, true = [clip[:, upper] for clip in made], [clip[:, upper] for clip in true]
    lengths = np.array([len(clip) for clip in true], float)
    speed = np.average([mean_speeds(clip) for clip in true], axis=0, weights=lengths)
    listen = lru_cache(lambda clip, trimmed: heard[clip].onsets(trimmed))

    def row(form: GestureForm) -> Row:
        trimmed = GESTURE_RULES[form].trimmed_frames
        looked_at = lengths - 2 * trimmed
        onsets = [listen(k, trimmed) if left > FRAME_RATE_HZ else np.zeros(0) for k, left in enumerate(looked_at)]

        def scored(clips: Sequence[Float[np.ndarray, "_ j 3"]]) -> tuple[_Scores, _Scores]:
            beats = [
                gesture_beats(clip, form, speed) if left > FRAME_RATE_HZ else []
                for clip, left in zip(clips, looked_at, strict=True)
            ]

            def score(motion: int, sound: int) -> float:
                events = overlapping(onsets[sound], onsets[motion])
                return gesture_alignment(beats[motion], events, form) if len(events) else float("nan")

            return _own_and_chance(score, len(clips), seed)

        weights = looked_at.clip(0) if trimmed else None
        return _row(f"ba_g_{form}", scored(made), scored(true), weights=weights, seed=seed)

    return [row(form) for form in get_args(GestureForm)]


def dance_rows(
    heard: Sequence[ClipAudio],
    made: Sequence[Float[np.ndarray, "_ j 3"]],
    true: Sequence[Float[np.ndarray, "_ j 3"]],
    *,
    seed: int = 0,
) -> list[Row]:
    """BA_D in all forms, over clips with music; empty if no clip has any."""
    if not any((clip.domain == MUSIC).any() for clip in heard):
        return []
    music = [clip.beats() for clip in heard]

    def row(form: DanceForm) -> Row:
        rule = DANCE_RULES[form]
        fps = DANCE_RATE_HZ if rule.sigma_frames else FRAME_RATE_HZ

        def scored(clips: Sequence[Float[np.ndarray, "_ j 3"]]) -> tuple[_Scores, _Scores]:
            beats = [dance_beats(at_rate(clip, fps), form, fps=fps) for clip in clips]

            def score(motion: int, sound: int) -> float:
                events, own = overlapping(music[sound], music[motion]), beats[motion]
                if rule.motion_is_query:  # only while both the clip's own music and the other music play
                    own = overlapping(own[heard[motion].falls_on(own, MUSIC)], events)
                return dance_alignment(own, events, form, fps=fps) if len(events) else float("nan")

            return _own_and_chance(score, len(clips), seed)

        return _row(f"ba_d_{form}", scored(made), scored(true), seed=seed)

    return [row(form) for form in get_args(DanceForm)]


def at_rate(positions: Float[np.ndarray, "t j 3"], fps: float) -> Float[np.ndarray, "n j 3"]:
    """Resample positions along splines; linear interpolation would have no speed minima between its corners."""
    if fps == FRAME_RATE_HZ:
        return positions
    last = len(positions) - 1
    times = np.arange(int(last * fps / FRAME_RATE_HZ) + 1) * FRAME_RATE_HZ / fps
    return np.asarray(CubicSpline(np.arange(last + 1), positions)(times))


def _own_and_chance(score: Score, clips: int, seed: int) -> tuple[_Scores, _Scores]:
    """Each clip's score with its own sound, and its chance level."""
    own = np.array([score(clip, clip) for clip in range(clips)])
    return own, chance_per_clip(shuffled_scores(score, clips, partners=PARTNERS, seed=seed))


def _row(
    name: str,
    made: tuple[_Scores, _Scores],
    true: tuple[_Scores, _Scores],
    *,
    weights: _Scores | None = None,
    seed: int,
) -> Row:
    """A row from the scores and chance levels of generated and true motion."""
    return row_of_means(
        name, "", made[0], truths=true[0], chances=made[1], truth_chances=true[1], weights=weights, seed=seed
    )
