"""Rate limits of clients: token buckets in memory, and a limit on wrong guesses of the server's token.

A client is identified by `wire.guard.network_of` its address. Addresses are never written to disk.
"""

import logging
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import NamedTuple

from .codec import ProtocolError
from .guard import has_token, network_of

_LOG = logging.getLogger(__name__)
_KEYS = 20_000  # clients that are remembered


class Rate(NamedTuple):
    """The size of a burst, and the requests per minute after it."""

    burst: float
    per_minute: float


class Limiter:
    """Token buckets by key; above `_KEYS`, the least recently used are dropped."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._levels: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def wait(self, key: str, rate: Rate, *, patience: float = 0.0) -> float:
        """Count a request, and return the seconds that it must wait; 0: it may pass.

        A request that would have to wait for longer than `patience` seconds is not counted, because it is refused.
        A negative patience counts nothing, and only asks.
        """
        with self._lock:
            now = self._clock()
            level, since = self._levels.pop(key, (rate.burst, now))
            level = min(rate.burst, level + (now - since) * rate.per_minute / 60)
            seconds = max(0.0, 1 - level) * 60 / rate.per_minute
            self._levels[key] = (level - 1 if seconds <= patience else level, now)
            if len(self._levels) > _KEYS:
                self._levels.popitem(last=False)
            return seconds


class TokenGate:
    """Checks the server's token, and makes an address that gave wrong ones wait.

    While it waits, even the right token is refused, so that guesses learn nothing. An address that gave the right token
    before does not wait: nobody can lock out the sessions of an office by guessing behind its router. One log line a
    minute tells how many wrong tokens came.
    """

    GUESSES = Rate(10, 6)

    def __init__(self, token: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._token, self._limiter = token, Limiter(clock)
        self._known: OrderedDict[str, None] = OrderedDict()  # networks that gave the right token
        self._wrong = 0  # since the last log line

    def check(self, given: str, headers: Mapping[str, str], address: str) -> None:
        """Check a token, given in a hello or in the Authorization header, that came from an address.

        Raises ProtocolError: `unauthorized`, or `overloaded` with `retry_after` if the address has to wait.
        """
        if not self._token:
            return
        network, wait = network_of(address), 0.0
        is_right = has_token(self._token, headers, given)
        if is_right and network not in self._known:
            wait = self._limiter.wait(network, self.GUESSES, patience=-1)
        elif not is_right and (given or "authorization" in headers):  # a request without a token is no guess
            self._note(address)
            wait = self._limiter.wait(network, self.GUESSES)
        if wait:
            raise too_often("too many wrong tokens came from this address", wait)
        if not is_right:
            raise ProtocolError("unauthorized", "wrong token; put the server's token into hello.token")
        self._known[network] = None
        self._known.move_to_end(network)
        if len(self._known) > _KEYS:
            self._known.popitem(last=False)

    def _note(self, address: str) -> None:
        self._wrong += 1
        if not self._limiter.wait("log", Rate(1, 1)):
            _LOG.warning("wrong tokens: %d since the last such line, the newest from %s", self._wrong, address)
            self._wrong = 0


def too_often(what: str, wait: float) -> ProtocolError:
    """The refusal of a client that does something too often; it may try again after `wait` seconds."""
    return ProtocolError("overloaded", f"{what}; try again in {math.ceil(wait)} s", retry_after=wait)
