"""Remove noise from recorded motion with a symmetric Hann window over time, which shifts nothing."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from .motion import Motion


def smooth_motion(motion: Motion, seconds: float) -> Motion:
    """Every joint and the root, averaged over a Hann window `seconds` wide (at half its height, half as wide).

    Quaternions are averaged in one hemisphere and normalised, which is exact to second order for the small rotations
    inside a window. The motion is mirrored at both ends.
    """
    half = round(seconds * motion.fps / 2)
    if half < 1:
        return motion
    quaternions = align_signs(motion.rotations)
    turned = _window_mean(quaternions, half)
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    return replace(
        motion, rotations=turned.astype(np.float32), root=_window_mean(motion.root, half).astype(np.float32)
    )


def align_signs(quaternions: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """The same rotations, with signs chosen so that interpolation between frames takes the short way."""
    is_flipped = (quaternions[1:] * quaternions[:-1]).sum(-1) < 0
    sign = np.where(np.cumsum(is_flipped, axis=0) % 2 == 1, np.float32(-1), np.float32(1))
    return np.concatenate([quaternions[:1], quaternions[1:] * sign[..., None]])


def _window_mean(values: NDArray[np.float32], half: int) -> NDArray[np.float64]:
    window = np.hanning(2 * half + 3)[1:-1]
    window /= window.sum()
    widths = [(half, half)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values.astype(np.float64), widths, mode="reflect" if len(values) > half else "edge")
    mean: NDArray[np.float64] = sum(weight * padded[k : k + len(values)] for k, weight in enumerate(window))
    return mean
