"""Uniform random numbers that depend on the session's seed and the absolute position alone.

So a session gives the same motion whether its sound comes in one push or many, and whatever sessions run beside it.
"""

import numpy as np
from jaxtyping import Float, Int, UInt

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def mix(x: UInt[np.ndarray, "..."]) -> UInt[np.ndarray, "..."]:
    """SplitMix64's finaliser, wrapping; every output bit depends on every input bit."""
    x = (x ^ (x >> np.uint64(30))) * FIRST
    x = (x ^ (x >> np.uint64(27))) * SECOND
    return np.asarray(x ^ (x >> np.uint64(31)))


def uniform_noise(
    seeds: Int[np.ndarray, " b"], start: Int[np.ndarray, " b"], *, count: int, codes: int
) -> Float[np.ndarray, "b n K"]:
    """Uniform numbers in (0, 1), double precision, for positions `start` .. `start` + `count` - 1 of each row."""
    counter = start[:, None] * codes + np.arange(1, count * codes + 1)
    word = mix(mix(seeds.astype(np.uint64) + GOLDEN)[:, None] + counter.astype(np.uint64) * GOLDEN)
    return ((word >> np.uint64(11)) + 0.5).reshape(len(seeds), count, codes) * 2.0**-53
