"""Sliding windows over time; the first and the last frame are repeated beyond the ends."""

import numpy as np
from jaxtyping import Float


def windows(values: Float[np.ndarray, "t ..."], half: int) -> Float[np.ndarray, "t ... w"]:
    """For each frame, the 2 `half` + 1 frames around it."""
    padded = np.pad(values, [(half, half)] + [(0, 0)] * (values.ndim - 1), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)


def weighted_mean(values: Float[np.ndarray, "t ..."], weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, "t ..."]:
    """For each frame, the mean of the frames around it; the middle one of an odd number of weights is its own."""
    return np.asarray(windows(values, len(weights) // 2) @ (weights / weights.sum()))
