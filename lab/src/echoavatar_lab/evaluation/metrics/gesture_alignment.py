"""BA_G: do a speaker's joints come to rest at acoustic onsets (paper, appendix Beat Alignment; EMAGE)?

For each joint the motion beats are local minima of its speed; onsets look for the nearest of them. Dimensionless,
0 to 1, mean over joints. The published forms share the formula and differ in what counts as a minimum:

- `paper`: every local minimum; sigma 0.3 s, which the paper does not give ("following EMAGE").
- `emage`: the code behind the tables of EMAGE, MECo and the paper. Speed over the joint's mean speed, minima over
  +-7 frames, kept above 0.3 of the mean. The first and last 60 frames are cut off. The test against 0.3 then reads the
  speed 60 frames too early, because it applies the index within the cut stretch to the whole clip.
- `evaltools`: the same with 0.1 for 0.3, as in EMAGE's later evaluation tools.
- `fixed`: `emage` with the test at the right frame.
- `sharp`: ours. Positions smoothed by one frame, minima below the joint's own mean speed, sigma 0.06 s.

The three EMAGE forms need each joint's mean speed in the data (`mean_speeds` of the true motion).
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import gaussian_filter1d
from scipy.signal import argrelextrema, find_peaks

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ

from .beat_alignment import SHARP_SIGMA_S, mean_hit_rate

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


def mean_speeds(positions: Float[np.ndarray, "t j 3"], fps: float = FRAME_RATE_HZ) -> Float[np.ndarray, " j"]:
    """Mean speed of each joint, m/s, which the EMAGE forms divide by (BEAT2 has fixed values for SMPL-X)."""
    return np.asarray(central_speed(positions, fps).mean(0))


def central_speed(positions: Float[np.ndarray, "t j 3"], fps: float = FRAME_RATE_HZ) -> Float[np.ndarray, "t j"]:
    """Length of the central difference over two frames (one-sided at the ends), m/s."""
    return np.asarray(np.linalg.norm(np.gradient(positions, axis=0) * fps, axis=-1))


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
    fps: float = FRAME_RATE_HZ,
) -> list[Shaped[np.ndarray, " _"]]:
    """The frames of each joint's motion beats, counted from the window's start; uses `central_speed`.

    Args:
        positions: metres.
        rule: one of `GESTURE_RULES` except `sharp`, whose beats lie between frames (`gesture_beats`).
        mean_speed: m/s for each joint; needed by rules with a threshold.
        window: first frame and end (exclusive) to consider; None: all but the trimmed ends.
        fps: frames per second.

    Raises:
        MotionError: the rule needs `mean_speed` and there is none, or the window is empty.
    """
    speed = central_speed(positions, fps)
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
    *,
    window: tuple[int, int] | None = None,
    fps: float = FRAME_RATE_HZ,
) -> list[Float[np.ndarray, " _"]]:
    """The times (s) of each joint's motion beats, counted from the window's start; arguments as above."""
    rule = GESTURE_RULES[form]
    if form == "sharp":
        speed = step_speed(positions, fps)
        minima = [find_peaks(-own, height=-own.mean(), distance=rule.order)[0] for own in speed.T]
        return [(at + 0.5) / fps for at in minima]
    return [at / fps for at in gesture_beat_frames(positions, rule, mean_speed, window=window, fps=fps)]


def gesture_alignment(
    beats: list[Float[np.ndarray, " _"]], onsets: Float[np.ndarray, " m"], form: GestureForm = "sharp"
) -> float:
    """BA_G of one clip: onsets (s, counted from the same start as the beats) look for the beats of each joint.

    `beats` holds the beats of the joints to be scored (`UPPER_BODY`, `SMPLX_UPPER_BODY`). NaN without onsets, where the
    published code divides by zero.
    """
    return mean_hit_rate(onsets, beats, GESTURE_RULES[form].sigma_s)
