"""Resample motion to another frame rate: slerp for rotations, a Catmull-Rom spline for the root."""

from fractions import Fraction

import numpy as np
import torch
from jaxtyping import Float, Int

from .motion import Motion
from .rotations import slerp


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another frame rate. It begins at the first frame and ends at or before the last.

    Frames at an instant that both rates share are copied exactly.
    """
    ratio = frame_ratio(motion.fps, fps)
    count = int((motion.frames - 1) / ratio) + 1
    steps = np.arange(count, dtype=np.int64) * ratio.numerator
    index = np.minimum(steps // ratio.denominator, motion.frames - 1)
    share = (steps % ratio.denominator) / ratio.denominator
    after = np.minimum(index + 1, motion.frames - 1)
    source = torch.from_numpy(motion.rotations.astype(np.float64))
    between = slerp(source[index], source[after], torch.from_numpy(share)[:, None]).numpy().astype(np.float32)
    is_shared = share == 0
    rotations = np.where(is_shared[:, None, None], motion.rotations[index], between)
    root = catmull_rom(motion.root, index, share)
    exact = np.where(is_shared[:, None], motion.root[index], root.astype(np.float32))
    return Motion(motion.skeleton, rotations, exact, fps)


def align_signs(quaternions: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """The same rotations, with signs chosen so that interpolation between frames takes the short way."""
    is_flipped = (quaternions[1:] * quaternions[:-1]).sum(-1) < 0
    sign = np.where(np.cumsum(is_flipped, axis=0) % 2 == 1, np.float32(-1), np.float32(1))
    return np.concatenate([quaternions[:1], quaternions[1:] * sign[..., None]])


def frame_ratio(source_fps: float, fps: float) -> Fraction:
    """Source frames per new frame, exactly; 29.97 means 30000/1001, and likewise 23.976 and 59.94."""
    return _fraction(source_fps) / _fraction(fps)


def _fraction(fps: float) -> Fraction:
    exact = Fraction(fps).limit_denominator(1001)
    film = Fraction(round(fps * 1001), 1001)
    is_film = film.numerator % 1000 == 0 and abs(float(film) - fps) < 5e-3 and exact.denominator != 1
    return film if is_film else exact


def catmull_rom(
    values: Float[np.ndarray, "t ..."], index: Int[np.ndarray, " n"], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n ..."]:
    """A cubic between frames `index` and `index` + 1, in double precision; it continues straight at both ends."""
    wide = values.astype(np.float64)
    first, last = (2 * wide[:1] - wide[1:2], 2 * wide[-1:] - wide[-2:-1]) if len(wide) > 1 else (wide, wide)
    wide = np.concatenate([first, wide, last, last])
    a, b, c, d = (wide[index + k] for k in range(4))
    u = share.reshape(-1, *([1] * (values.ndim - 1)))
    curve: np.ndarray = b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    return curve
