"""Rate limits: token buckets in memory. Addresses are never written to disk."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

_KEYS = 20_000


class Rate(NamedTuple):
    """The size of a burst, and the requests per minute after it."""

    burst: float
    per_minute: float


@dataclass(frozen=True)
class Rates:
    """The limits of an address, a session or an account."""

    login: Rate = Rate(8, 6)  # per address
    join: Rate = Rate(60, 60)  # per address: a whole classroom may join through one router
    answer: Rate = Rate(30, 60)  # per rater
    read: Rate = Rate(400, 1200)  # per session, clips and sounds included
    stranger: Rate = Rate(120, 240)  # per address, for requests without a session
    account: Rate = Rate(100, 60)  # sign-ins to one account from addresses that never succeeded


class Limiter:
    """Buckets by key; if there are too many, the longest unused are dropped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._levels: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def wait(self, key: str, rate: Rate) -> float:
        """Count a request and return 0 if it may pass; otherwise return the seconds to wait."""
        with self._lock:
            now = self._clock()
            level, since = self._levels.pop(key, (rate.burst, now))
            level = min(rate.burst, level + (now - since) * rate.per_minute / 60)
            passes = level >= 1
            self._levels[key] = (level - 1 if passes else level, now)
            if len(self._levels) > _KEYS:
                self._levels.popitem(last=False)
            return 0.0 if passes else (1 - level) * 60 / rate.per_minute
