"""What goes on between two steps of a stage in a session: the other models, whose weights take the caches.

A stage timed again and again by itself finds everything where it left it, which in a session it never does: one session
then costs a fifth of what it costs in use, and a batch, which needs more than the caches hold anyway, half.
"""

from collections.abc import Callable

import numpy as np

WEIGHTS = 15_000_000  # numbers, 60 MB: those of the default bundle's models


def other_models() -> Callable[[], None]:
    """Something to call before every timed step: it goes through as much memory as the models do for a chunk."""
    weights = np.zeros(WEIGHTS, np.float32)

    def work() -> None:
        np.add(weights, np.float32(1), out=weights)  # in one thread

    return work
