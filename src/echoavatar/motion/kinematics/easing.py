"""Smooth steps for fades, for NumPy arrays and tensors alike; compiled loops have their own (`idle_motion`)."""

from typing import TypeVar

import numpy as np
from torch import Tensor

Shares = TypeVar("Shares", np.ndarray, Tensor)


def smootherstep(share: Shares) -> Shares:
    """0 to 1 for shares of 0 to 1, with no speed and no acceleration at either end."""
    eased: Shares = share**3 * (10 - share * (15 - 6 * share))
    return eased


def falloff(value: Tensor, full: float, none: float) -> Tensor:
    """1 up to `full`, 0 from `none` on, smooth between."""
    return 1 - smootherstep(((value - full) / (none - full)).clamp(0, 1))
