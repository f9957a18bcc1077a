"""BA_D: does a dance brake on the beats of the music (paper, appendix Beat Alignment)? Dimensionless, 0 to 1.

- `paper`: motion beats are local maxima of deceleration of the mean joint speed, unsmoothed; music beats look for
  motion beats. The paper does not give sigma and its code lacks the score. Ours: 0.05 s, 3 frames at 60 fps.
- `bailando`: minima of the mean joint speed smoothed over 5 frames; music beats look for motion beats; sigma 3 frames.
- `aist`: minima over +-10 frames of the summed joint speed; motion beats look for MUSIC beats, so that few well placed
  beats score high; sigma 3 frames.
- `sharp`: ours. Maxima of deceleration of positions smoothed by one frame, at least 3 frames apart, sigma 0.06 s.

A sigma in frames makes the score depend on the frame rate; Bailando and AIST++ assume 60 fps. The chance level depends
on how frequent motion beats are and differs between the forms: compare scores only within a form.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter1d
from scipy.signal import argrelextrema, find_peaks

from echoavatar.timing import FRAME_RATE_HZ

from .beat_alignment import SHARP_SIGMA_S, hit_rate
from .gesture_alignment import step_speed

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
