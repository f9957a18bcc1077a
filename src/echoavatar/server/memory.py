"""Freed memory goes back to the system.

A session holds some 20 MB. glibc keeps such blocks for the next one, between blocks that are in use, and so a server
whose sessions come and go grows by a hundred megabytes, though as much is in use as at its start.
"""

import ctypes
from collections.abc import Callable
from functools import lru_cache


def give_back() -> None:
    """Give all whole pages that are free back to the system; some milliseconds. Only glibc needs it, and can do it."""
    _trim()(0)


@lru_cache(maxsize=1)
def _trim() -> Callable[[int], object]:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library; Windows has no library without a name
        return lambda padding: padding
