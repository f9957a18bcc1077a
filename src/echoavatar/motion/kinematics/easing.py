"""Smooth steps for fades: of arrays, and of a single number in a compiled loop."""

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel


def smootherstep(share: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """0 to 1 for shares of 0 to 1, with no speed and no acceleration at either end."""
    eased: np.ndarray = share**3 * (10 - share * (15 - 6 * share))
    return eased


@kernel()
def smoothstep(share):  # type: ignore[no-untyped-def]
    """0 to 1 for shares of 0 to 1, with no speed at either end; other shares count as the nearest of these."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def falloff(value: Float[np.ndarray, "*n"], full: float, none: float) -> Float[np.ndarray, "*n"]:
    """1 up to `full`, 0 from `none` on, smooth between."""
    return 1 - smootherstep(np.clip((value - full) / (none - full), 0, 1))
