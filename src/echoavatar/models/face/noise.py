"""The noise from which a face is made, and the noise levels of the steps (paper: 3 steps; times from 1000 down).

The noise follows from the session's seed and the absolute frame alone. The release draws anew for every frame. Here
draws are `hold` frames apart, and between them the noise moves smoothly from one to the next at unit variance, so that
the face trembles less. A hold of 1 draws every frame.
"""

import math

import numpy as np
from jaxtyping import Float, Int

from ..noise import uniform_noise

_SALT = 0x666163652D6E6F69  # so that the noise differs from the motion generator's for the same seed
FULL_NOISE = 1000


def normal_noise(
    seeds: Int[np.ndarray, " b"], start: Int[np.ndarray, " b"], *, count: int, channels: int
) -> Float[np.ndarray, "b n c"]:
    """Independent standard normal numbers (Box-Muller, double) for positions `start` .. `start` + `count` - 1."""
    pairs = uniform_noise(seeds ^ _SALT, start, count=count, codes=2 * channels)
    radius = np.sqrt(-2 * np.log(pairs[..., :channels]))
    return np.asarray(radius * np.cos(2 * math.pi * pairs[..., channels:]))


def face_noise(
    seeds: Int[np.ndarray, " b"], start: Int[np.ndarray, " b"], *, count: int, channels: int, hold: int
) -> Float[np.ndarray, "b n c"]:
    """Noise of the frames `start` .. `start` + `count` - 1 of each row."""
    if hold == 1:
        return normal_noise(seeds, start, count=count, channels=channels)
    frame = start[:, None] + np.arange(count)
    first = start // hold
    draws = normal_noise(seeds, first, count=(count + hold - 1) // hold + 2, channels=channels)
    row, place = np.arange(len(seeds))[:, None], frame // hold - first[:, None]
    angle = (frame % hold)[..., None] * (math.pi / 2 / hold)
    return np.asarray(draws[row, place] * np.cos(angle) + draws[row, place + 1] * np.sin(angle))


def euler_levels(steps: int) -> tuple[list[float], list[float]]:
    """Times 1000 .. 1, evenly, and the noise levels (times / 1000, then 0)."""
    times = [FULL_NOISE - (FULL_NOISE - 1) * index / max(steps - 1, 1) for index in range(steps)]
    return times, [time / FULL_NOISE for time in times] + [0.0]
