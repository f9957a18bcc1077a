"""Interpolation between key poses: minimum-jerk glides that arrive on time and rest there.

A glide has no velocity and no acceleration at its ends (Flash and Hogan 1985), so the speed of the body has a minimum
where a pose arrives on a beat. Everything is vectorised over frames.
"""

import numpy as np
from numpy.typing import NDArray

from .controls import Array, minimum_jerk


def progress(t: Array, arrive: Array, travel: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """For each time, the key that the move begins at, the key that it leads to, and the phase 0..1 of the move.

    Args:
        t: times, (frames,)
        arrive: increasing times of arrival, (keys,)
        travel: how long each move takes, at most the gap to the key before, (keys,)
    """
    index = np.searchsorted(arrive, t, side="left")
    after = np.minimum(index, len(arrive) - 1)
    phase = np.clip((t - arrive[after]) / travel[after] + 1.0, 0.0, 1.0)
    return np.maximum(index - 1, 0), after, np.where(index >= len(arrive), 1.0, phase)


def glide(t: Array, arrive: Array, values: Array, travel: Array | None = None) -> Array:
    """Values at times `t`, (frames, ...): move by minimum jerk from key to key and rest at each; constant outside.

    Args:
        t: times, (frames,)
        arrive: increasing times of arrival, (keys,)
        values: the value at each arrival, (keys, ...)
        travel: how long each move takes, (keys,), at most the gap to the key before; None means the whole gap
    """
    before, after, phase = progress(t, arrive, gaps(arrive, travel))
    share = minimum_jerk(phase).reshape(-1, *([1] * (values.ndim - 1)))
    result: Array = values[before] * (1.0 - share) + values[after] * share
    return result


def gaps(arrive: Array, travel: Array | None = None) -> Array:
    """Time from the previous key to each key, or `travel` where that is shorter."""
    gap = np.maximum(np.diff(arrive, prepend=arrive[0] - 1.0), 1e-3)
    return gap if travel is None else np.minimum(gap, np.maximum(travel, 1e-3))
