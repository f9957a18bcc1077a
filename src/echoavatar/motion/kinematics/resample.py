"""Resample motion to another frame rate: slerp for rotations, a spline or straight lines for the root."""

from fractions import Fraction

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from .motion import Motion
from .rotations import slerp


def resample(motion: Motion, fps: float, *, is_cubic: bool = True) -> Motion:
    """The same motion at another frame rate. It begins at the first frame and ends at or before the last.

    Rates are taken as fractions with denominators up to 1001, so 29.97 means 30000/1001. Frames at an instant of the
    old rate are copied exactly. The root follows a Catmull-Rom spline, or straight lines with `is_cubic=False`.
    """
    ratio = _fraction(motion.fps) / _fraction(fps)  # source frames per new frame
    count = int((motion.frames - 1) / ratio) + 1
    steps = np.arange(count, dtype=np.int64) * ratio.numerator
    index = np.minimum(steps // ratio.denominator, motion.frames - 1)
    share = (steps % ratio.denominator) / ratio.denominator
    after = np.minimum(index + 1, motion.frames - 1)
    source = torch.from_numpy(motion.rotations.astype(np.float64))
    between = slerp(source[index], source[after], torch.from_numpy(share)[:, None]).numpy().astype(np.float32)
    is_shared = share == 0
    rotations = np.where(is_shared[:, None, None], motion.rotations[index], between)
    root = _spline(motion.root, index, share) if is_cubic else _line(motion.root, index, after, share)
    exact = np.where(is_shared[:, None], motion.root[index], root.astype(np.float32))
    return Motion(motion.skeleton, rotations, exact, fps)


def align_signs(quaternions: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """The same rotations, with signs chosen so that interpolation between frames takes the short way."""
    is_flipped = (quaternions[1:] * quaternions[:-1]).sum(-1) < 0
    sign = np.where(np.cumsum(is_flipped, axis=0) % 2 == 1, np.float32(-1), np.float32(1))
    return np.concatenate([quaternions[:1], quaternions[1:] * sign[..., None]])


def _fraction(fps: float) -> Fraction:
    exact = Fraction(fps).limit_denominator(1001)
    film = Fraction(round(fps * 1001), 1001)  # 23.976, 29.97, 59.94
    is_film = film.numerator % 1000 == 0 and abs(float(film) - fps) < 5e-3 and exact.denominator != 1
    return film if is_film else exact


def _line(
    points: NDArray[np.float32],
    index: NDArray[np.int64],
    after: NDArray[np.int64],
    share: NDArray[np.float64],
) -> NDArray[np.float64]:
    weight = share[:, None]
    return points[index] * (1 - weight) + points[after] * weight


def _spline(points: NDArray[np.float32], index: NDArray[np.int64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """A Catmull-Rom spline that continues straight at both ends."""
    if len(points) < 2:
        return points[index].astype(np.float64)
    wide = points.astype(np.float64)
    wide = np.concatenate([2 * wide[:1] - wide[1:2], wide, 2 * wide[-1:] - wide[-2:-1], wide[-1:]])
    a, b, c, d = (wide[index + k] for k in range(4))
    u = share[:, None]
    curve: NDArray[np.float64] = b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    return curve
