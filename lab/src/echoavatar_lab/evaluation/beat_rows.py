"""Rows of beat alignment with chance levels: in every form (`ba_g_...`, `ba_d_...`), and on labelled events.

If a clip has domain labels, only onsets in speech and beats in music count. Chance is the same motion with the events
of up to 20 other clips, restricted to the time span of its own events. A score means nothing without it.
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
from echoavatar_lab.data import MUSIC, SPEECH, Clip

from .measures import Track
from .metrics.beat_alignment import (
    ARM_JOINTS,
    DANCE_RULES,
    EMAGE_RATE_HZ,
    GESTURE_RULES,
    SHARP_SIGMA_S,
    STROKE_DELAY_S,
    UPPER_BODY,
    DanceForm,
    GestureForm,
    Score,
    chance_per_clip,
    dance_alignment,
    dance_beats,
    gesture_alignment,
    gesture_beats,
    mean_hit_rate,
    mean_speeds,
    music_beats,
    overlapping,
    shuffled_scores,
    speech_onsets,
    step_speed,
)
from .table import Row, row_of_means

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


def event_rows(clips: Sequence[Clip], made: Sequence[Track], true: Sequence[Track], *, seed: int = 0) -> list[Row]:
    """Timing on the events that clips are labelled with, in the `sharp` forms, on our rig.

    `ba_onset` is the alignment of the arms with stressed syllables, at the delay of a stroke, and `ba_beat` that of the
    body with beats. `stroke_contrast` is the speed of the arms on stressed syllables over that after them, `beat_dip`
    the speed of the body on beats over its mean.
    """
    arms = HUMANOID.indices(ARM_JOINTS)
    stresses, beats = ([clip.events.get(kind, np.zeros(0)) for clip in clips] for kind in ("stress", "beats"))
    strokes = [[gesture_beats(track.positions[:, arms]) for track in side] for side in (made, true)]
    dances = [[[dance_beats(track.positions)] for track in side] for side in (made, true)]
    rows = [
        alignment_row("ba_onset", [times + STROKE_DELAY_S for times in stresses], *strokes, seed=seed),
        alignment_row("ba_beat", beats, *dances, seed=seed),
    ]

    def contrast(tracks: Sequence[Track]) -> float:
        stroke, after = (_speeds(tracks, stresses, span, arms) for span in ((-0.1, 0.07), (0.17, 0.43)))
        return stroke / after

    def dip(tracks: Sequence[Track]) -> float:
        return _speeds(tracks, beats, (0.0, 0.04), range(HUMANOID.joints))

    rows.append(Row("stroke_contrast", "", contrast(made), truth=contrast(true)))
    return [*rows, Row("beat_dip", "", dip(made), truth=dip(true))]


def alignment_row(
    name: str,
    events: Sequence[_Times],
    made: Sequence[Sequence[_Times]],
    true: Sequence[Sequence[_Times]] | None = None,
    *,
    seed: int = 0,
) -> Row:
    """Hit rate of each clip's events (s) by the beats of each of its joints (s), within the tolerance of `sharp`."""

    def scored(beats: Sequence[Sequence[_Times]]) -> tuple[_Scores, _Scores]:
        def score(motion: int, sound: int) -> float:
            asking = overlapping(events[sound], events[motion])
            return mean_hit_rate(asking, beats[motion], SHARP_SIGMA_S) if len(asking) else float("nan")

        return _own_and_chance(score, len(beats), seed)

    return _row(name, scored(made), None if true is None else scored(true), seed=seed)


def speed_around(
    positions: Float[np.ndarray, "t j 3"], events: _Times, seconds: tuple[float, float]
) -> Float[np.ndarray, " m"]:
    """Mean joint speed in this time span around each event, over its mean from a second before to a second after."""
    speed = step_speed(positions).mean(1)
    first, last = (round(second * FRAME_RATE_HZ) for second in seconds)
    at = np.round(np.asarray(events) * FRAME_RATE_HZ).astype(int)
    at = at[(at >= FRAME_RATE_HZ) & (at + FRAME_RATE_HZ < len(speed))]
    near = [speed[k + first : k + last + 1].mean() for k in at]
    wide = [speed[k - FRAME_RATE_HZ : k + FRAME_RATE_HZ].mean() + 1e-6 for k in at]
    return np.asarray(np.array(near) / np.array(wide))


def _speeds(
    tracks: Sequence[Track], events: Sequence[_Times], seconds: tuple[float, float], joints: Sequence[int]
) -> float:
    """Mean of `speed_around` over all events of all clips, joints relative to the hips."""
    joined = np.concatenate(
        [
            speed_around((track.positions - track.positions[:, :1])[:, list(joints)], times, seconds)
            for track, times in zip(tracks, events, strict=True)
        ]
    )
    return float(joined.mean()) if len(joined) else float("nan")


def _own_and_chance(score: Score, clips: int, seed: int) -> tuple[_Scores, _Scores]:
    """Each clip's score with its own sound, and its chance level."""
    own = np.array([score(clip, clip) for clip in range(clips)])
    return own, chance_per_clip(shuffled_scores(score, clips, partners=PARTNERS, seed=seed))


def _row(
    name: str,
    made: tuple[_Scores, _Scores],
    true: tuple[_Scores, _Scores] | None,
    *,
    weights: _Scores | None = None,
    seed: int,
) -> Row:
    """A row from the scores and chance levels of generated and true motion."""
    truths, truth_chances = true or (None, None)
    return row_of_means(
        name, "", made[0], truths=truths, chances=made[1], truth_chances=truth_chances, weights=weights, seed=seed
    )
