"""Smooth steps for fades: of NumPy arrays and tensors alike, and of a single number in a compiled loop."""

from typing import TypeVar

import numpy as np
from torch import Tensor

from echoavatar.nn.kernels import kernel

Shares = TypeVar("Shares", np.ndarray, Tensor)


def smootherstep(share: Shares) -> Shares:
    """0 to 1 for shares of 0 to 1, with no speed and no acceleration at either end."""
    eased: Shares = share**3 * (10 - share * (15 - 6 * share))
    return eased


@kernel()
def smoothstep(share):  # type: ignore[no-untyped-def]
    """0 to 1 for shares of 0 to 1, with no speed at either end; other shares count as the nearest of these."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def falloff(value: Tensor, full: float, none: float) -> Tensor:
    """1 up to `full`, 0 from `none` on, smooth between."""
    return 1 - smootherstep(((value - full) / (none - full)).clamp(0, 1))
