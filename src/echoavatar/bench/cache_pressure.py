"""Stands in for the other models of a session between two timed calls of one stage: it evicts the caches.

A stage timed by itself in a loop finds its data still in the caches. In a session the other models' weights have
replaced it, so the isolated measurement would be far too optimistic.
"""

from collections.abc import Callable

import numpy as np

WEIGHTS = 15_000_000  # float32 values, 60 MB: about the weights of the default bundle


def evict_caches() -> Callable[[], None]:
    """Returns a function to call before every timed step; it touches as much memory as the models do in a chunk."""
    weights = np.zeros(WEIGHTS, np.float32)

    def work() -> None:
        np.add(weights, np.float32(1), out=weights)  # single-threaded

    return work
