"""Beat alignment (paper, appendix Beat Alignment, GAHR): audio events, motion beats, their distance, and chance.

    hit rate = mean over events e of exp(-min_b (e - b)^2 / 2 sigma^2)

Dimensionless, 0 to 1. docs/metrics.md lists the forms: motion beats, which events look for which, sigma. A score means
nothing alone, because frequent beats are near everything: report it with its chance level, each motion
scored with the audio of other clips, and compare within a form only. Shuffling keeps the statistics of both (how
frequent their beats are, how lively they are) and removes only their correspondence.

Audio events are speech onsets and music beats, found by librosa as in the paper. The detectors' settings are part of a
published score: 16 kHz, hop 512, defaults otherwise (EMAGE's onsets, and music beats rounded to 32 ms). The `sharp`
forms use beats with a hop of 256 at 24 kHz.

BA_G: do a speaker's joints come to rest at acoustic onsets (EMAGE)? Mean over joints. The EMAGE forms need each joint's
mean speed in the data (`mean_speeds` of the true motion). `emage`, the code behind the tables of EMAGE, MECo and the
paper, cuts off the first and last 60 frames and then tests a speed 60 frames too early, because it applies the index
within the cut stretch to the whole clip; `fixed` tests the right frame.

BA_D: does a dance brake on the beats of the music? Of `paper` neither sigma nor code is published; ours is 3 frames at
60 fps. In `aist` motion beats look for MUSIC beats, so that few well placed beats score high. A sigma in frames makes
the score depend on the frame rate; Bailando and AIST++ assume 60 fps.
"""

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numba
import numpy as np
from filelock import FileLock
from jaxtyping import Float, Int, Shaped
from scipy.ndimage import gaussian_filter1d
from scipy.signal import argrelextrema, find_peaks

from echoavatar.cache import NOWHERE, user_caches
from echoavatar.errors import MotionError
from echoavatar.nn.kernels import cache_folder
from echoavatar.timing import FRAME_RATE_HZ

EMAGE_RATE_HZ = 16_000
SHARP_SIGMA_S = 0.06
"""Tolerance of our own `sharp` forms in seconds. With the usual 0.3 s any lively motion scores near 1."""


def speech_onsets(audio: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " n"]:
    """Acoustic onsets (s) from librosa's detector with hop 512 and no backtracking."""
    found = _librosa().onset.onset_detect(y=audio, sr=rate, hop_length=512, units="time")
    return np.asarray(found, np.float64)


def music_beats(audio: Float[np.ndarray, " s"], rate: int, *, hop: int = 256) -> Float[np.ndarray, " n"]:
    """Beats (s) from librosa's tracker, for recordings without beat labels."""
    _, times = _librosa().beat.beat_track(y=audio, sr=rate, hop_length=hop, units="time")
    return np.asarray(times, np.float64)


@functools.cache
def _librosa() -> Any:
    """Import librosa with its compiled parts, one process at a time.

    The first import compiles and caches them. If several processes do that at once, numba leaves inconsistent files in
    its cache, and every later process that reads them crashes (numba issue 10128). They are cached where our kernels
    are, because numba refuses to import them for a user without a home, and librosa does, too.
    """
    folder = cache_folder()
    if folder == NOWHERE:
        raise MotionError("librosa keeps compiled code, and nothing can be written here; set NUMBA_CACHE_DIR")
    numba.config.CACHE_DIR = numba.config.CACHE_DIR or str(folder)
    if not user_caches():
        os.environ["XDG_CACHE_HOME"] = str(folder)
    with FileLock(folder / "librosa.lock"):
        import librosa.beat
        import librosa.onset
    return librosa


def hits(events: Shaped[np.ndarray, " n"], beats: Shaped[np.ndarray, " m"], sigma: float) -> Float[np.ndarray, " n"]:
    """Hit of each event by the nearest beat: 1 at the beat, 0 far from it or without beats."""
    if not len(beats):
        return np.zeros(len(events))
    distance = np.abs(np.asarray(events, np.float64)[:, None] - np.asarray(beats, np.float64)[None]).min(1)
    return np.asarray(np.exp(-(distance**2) / (2 * sigma**2)))


def hit_rate(events: Shaped[np.ndarray, " n"], beats: Shaped[np.ndarray, " m"], sigma: float) -> float:
    """Mean hit of each event by the nearest beat, all in the unit of `sigma`; 0 without beats, NaN without events."""
    if not len(events):
        return float("nan")
    return float(hits(events, beats, sigma).mean())


def mean_hit_rate(events: Shaped[np.ndarray, " n"], beats: Sequence[Shaped[np.ndarray, " _"]], sigma: float) -> float:
    """`hit_rate` averaged over joints with their own beats; a joint without beats counts as 0."""
    return float(np.mean([hit_rate(events, own, sigma) for own in beats]))


def overlapping(events: Float[np.ndarray, " n"], own: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
    """Another clip's events that lie between the first and the last of `own`; none if `own` is empty."""
    if not len(own):
        return np.asarray(events[:0])
    return np.asarray(events[(events >= own.min()) & (events <= own.max())])


Score = Callable[[int, int], float]
"""Motion of clip i with the audio of clip j; NaN if the pair cannot be scored."""


def shuffled_scores(
    score: Score, clips: int, *, partners: int | None = None, seed: int = 0
) -> Float[np.ndarray, "n k"]:
    """Score every motion with the audio of other clips: all of them, or `partners` drawn without repetition.

    NaN where a pair cannot be scored; no columns for a single clip, which has no other.
    """
    others = max(clips - 1, 0)
    count = others if partners is None else min(partners, others)
    random = np.random.default_rng(seed)
    scores = np.full((clips, count), np.nan)
    for i in range(clips):
        steps = np.arange(1, clips) if count == others else 1 + random.permutation(others)[:count]
        scores[i] = [score(i, int(j)) for j in (i + steps) % clips]
    return scores


def chance_per_clip(scores: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Each motion's chance level: the mean of the finite scores in its row; NaN if there are none."""
    rows = [row[np.isfinite(row)] for row in scores]
    return np.array([row.mean() if len(row) else np.nan for row in rows])


GestureForm = Literal["paper", "emage", "evaltools", "fixed", "sharp"]

SMPLX_UPPER_BODY = (3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21)
"""Spine, neck, collars, head, shoulders, elbows, wrists among the 55 joints of SMPL-X, as EMAGE lists them."""
UPPER_BODY = ("spine", "chest", "upperChest", "neck", "leftShoulder", "rightShoulder", "head") + (
    "leftUpperArm", "rightUpperArm", "leftLowerArm", "rightLowerArm", "leftHand", "rightHand"
)  # fmt: skip
"""The same 13 joints of our rig."""
ARM_JOINTS = ("leftLowerArm", "leftHand", "rightLowerArm", "rightHand")
STROKE_DELAY_S = 0.18
"""Rehearsal gestures end 0.14 to 0.18 s after the stressed vowel, and the wrist is slowest just after. Alignment with
rehearsal speech is measured at this delay, for generated and true motion alike; with recordings at none."""
TRIMMED_FRAMES = 60
SMOOTHING_FRAMES = 1.0


class GestureRule(NamedTuple):
    """What one form counts as a motion beat, and its tolerance."""

    sigma_s: float
    order: int  # frames to either side that a minimum must be below
    threshold: float | None  # in units of the joint's mean speed; None: any minimum, and speed in m/s
    is_shifted: bool = False  # the threshold is tested on the whole clip with the index within the window
    trimmed_frames: int = 0  # cut off at both ends of motion and audio


GESTURE_RULES: dict[GestureForm, GestureRule] = {
    "paper": GestureRule(0.3, 1, None),
    "emage": GestureRule(0.3, 7, 0.3, True, TRIMMED_FRAMES),
    "evaltools": GestureRule(0.3, 7, 0.1, True, TRIMMED_FRAMES),
    "fixed": GestureRule(0.3, 7, 0.3, False, TRIMMED_FRAMES),
    "sharp": GestureRule(SHARP_SIGMA_S, 3, None),
}


def mean_speeds(positions: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, " j"]:
    """Mean speed of each joint, m/s, which the EMAGE forms divide by (BEAT2 has fixed values for SMPL-X)."""
    return np.asarray(central_speed(positions).mean(0))


def central_speed(positions: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j"]:
    """Length of the central difference over two frames of 30 fps (one-sided at the ends), m/s."""
    return np.asarray(np.linalg.norm(np.gradient(positions, axis=0) * FRAME_RATE_HZ, axis=-1))


def step_speed(positions: Float[np.ndarray, "t j 3"], fps: float = FRAME_RATE_HZ) -> Float[np.ndarray, "t-1 j"]:
    """Speed from frame to frame, m/s, of positions smoothed by one frame to suppress noise."""
    smooth = gaussian_filter1d(positions, SMOOTHING_FRAMES, axis=0, mode="nearest")
    return np.asarray(np.linalg.norm(np.diff(smooth, axis=0), axis=-1) * fps)


def gesture_beat_frames(
    positions: Float[np.ndarray, "t j 3"],
    rule: GestureRule,
    mean_speed: Float[np.ndarray, " j"] | None = None,
    *,
    window: tuple[int, int] | None = None,
) -> list[Shaped[np.ndarray, " _"]]:
    """The frames of each joint's motion beats, counted from the window's start; uses `central_speed`.

    Args:
        positions: metres, at 30 frames per second.
        rule: one of `GESTURE_RULES` except `sharp`, whose beats lie between frames (`gesture_beats`).
        mean_speed: m/s for each joint; needed by rules with a threshold.
        window: first frame and end (exclusive) to consider; None: all but the trimmed ends.

    Raises:
        MotionError: the rule needs `mean_speed` and there is none, or the window is empty.
    """
    speed = central_speed(positions)
    if rule.threshold is not None:
        if mean_speed is None:
            raise MotionError("this form of BA_G needs the joints' mean speeds; pass `mean_speeds` of the true motion")
        speed = speed / np.maximum(mean_speed, 1e-9)
    start, stop = window or (rule.trimmed_frames, len(speed) - rule.trimmed_frames)
    if stop - start < 2:
        raise MotionError(
            f"{len(speed)} frames are too few to cut {rule.trimmed_frames} off both ends; use longer clips"
        )
    found = []
    for whole in speed.T:
        inside = whole[start:stop]
        at = argrelextrema(inside, np.less, order=rule.order)[0]
        if rule.threshold is not None:
            at = at[(whole if rule.is_shifted else inside)[at] > rule.threshold]
        found.append(at)
    return found


def gesture_beats(
    positions: Float[np.ndarray, "t j 3"],
    form: GestureForm = "sharp",
    mean_speed: Float[np.ndarray, " j"] | None = None,
) -> list[Float[np.ndarray, " _"]]:
    """The times (s) of each joint's motion beats, counted from the end of the trimmed start; arguments as above."""
    rule = GESTURE_RULES[form]
    if form == "sharp":
        speed = step_speed(positions)
        minima = [find_peaks(-own, height=-own.mean(), distance=rule.order)[0] for own in speed.T]
        return [(at + 0.5) / FRAME_RATE_HZ for at in minima]
    return [at / FRAME_RATE_HZ for at in gesture_beat_frames(positions, rule, mean_speed)]


def gesture_alignment(
    beats: list[Float[np.ndarray, " _"]], onsets: Float[np.ndarray, " m"], form: GestureForm = "sharp"
) -> float:
    """BA_G of one clip: onsets (s, counted from the same start as the beats) look for the beats of each joint.

    `beats` holds the beats of the joints to be scored (`UPPER_BODY`, `SMPLX_UPPER_BODY`). NaN without onsets, where the
    published code divides by zero.
    """
    return mean_hit_rate(onsets, beats, GESTURE_RULES[form].sigma_s)


DanceForm = Literal["paper", "bailando", "aist", "sharp"]


class DanceRule(NamedTuple):
    """Tolerance, and which events look for which."""

    sigma_frames: float | None  # None: `sigma_s` applies at any frame rate
    sigma_s: float | None
    motion_is_query: bool = False  # motion beats look for music beats


DANCE_RULES: dict[DanceForm, DanceRule] = {
    "paper": DanceRule(None, 0.05),
    "bailando": DanceRule(3.0, None),
    "aist": DanceRule(3.0, None, motion_is_query=True),
    "sharp": DanceRule(None, SHARP_SIGMA_S),
}
BAILANDO_SMOOTHING_FRAMES = 5.0
AIST_ORDER_FRAMES = 10


def dance_beat_frames(
    positions: Float[np.ndarray, "t j 3"], form: Literal["paper", "bailando", "aist"]
) -> Int[np.ndarray, " n"]:
    """Frames of the motion beats as the published forms count them.

    Speed k is that of the step from frame k to k + 1. Bailando reports its minima at k, AIST++ at k + 1. Deceleration k
    compares steps k and k + 1, which meet at frame k + 1.
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    if form == "bailando":
        smooth = gaussian_filter1d(steps.mean(1), BAILANDO_SMOOTHING_FRAMES)
        return np.asarray(argrelextrema(smooth, np.less)[0])
    if form == "aist":
        with_start = np.concatenate([[0.0], steps.sum(1)])  # the first frame has no step; it counts as still
        return np.asarray(argrelextrema(with_start, np.less, order=AIST_ORDER_FRAMES)[0])
    braking = -np.diff(steps.mean(1))
    at = argrelextrema(braking, np.greater)[0]
    return np.asarray(at[braking[at] > 0] + 1)


def dance_beats(
    positions: Float[np.ndarray, "t j 3"], form: DanceForm = "sharp", *, fps: float = FRAME_RATE_HZ
) -> Float[np.ndarray, " n"]:
    """Times (s) of the motion beats."""
    if form == "sharp":
        braking = -np.diff(step_speed(positions, fps).mean(1))
        return np.asarray((find_peaks(braking, height=0.0, distance=3)[0] + 1.0) / fps)
    return np.asarray(dance_beat_frames(positions, form) / fps)


def dance_alignment(
    beats: Float[np.ndarray, " n"],
    music: Float[np.ndarray, " m"],
    form: DanceForm = "sharp",
    *,
    fps: float = FRAME_RATE_HZ,
) -> float:
    """BA_D of one clip from motion beats and music beats, both in seconds; NaN if the asking events are none."""
    rule = DANCE_RULES[form]
    sigma = rule.sigma_s if rule.sigma_s is not None else (rule.sigma_frames or 0.0) / fps
    asking, asked = (beats, music) if rule.motion_is_query else (music, beats)
    return hit_rate(asking, asked, sigma)
