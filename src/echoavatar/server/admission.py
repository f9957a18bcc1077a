"""Admission of WebSockets. A connection that has not said `hello` gives way to a new one."""

from collections import Counter
from typing import Protocol

from echoavatar.wire.guard import network_of


class Waiting(Protocol):
    """The hello of a connection, as far as it can be called off: a cancel scope."""

    def cancel(self) -> None:
        """Stop waiting."""
        ...


class Admission:
    """Open connections, at most `limit`. Each is known by the scope in which it waits for its hello."""

    def __init__(self, limit: int, per_address: int | None = None) -> None:
        self._limit, self._per_address = limit, per_address or limit
        self._greeted: dict[Waiting, str] = {}  # with the client's address
        self._waiting: dict[Waiting, str] = {}  # with the client's address, the oldest first

    def __len__(self) -> int:
        return len(self._greeted) + len(self._waiting)

    def enter(self, scope: Waiting, address: str) -> bool:
        """Admit a connection; returns False if there is no room.

        If an address has as many as it may, it gives up its own oldest silent connection; if all are taken, the address
        with the most silent connections does.
        """
        address = network_of(address)
        own = [*self._waiting.values(), *self._greeted.values()].count(address)
        if own >= self._per_address:
            busiest = address
        elif len(self) >= self._limit and self._waiting:
            busiest, _ = Counter(self._waiting.values()).most_common(1)[0]
        elif len(self) >= self._limit:
            return False
        else:
            busiest = None
        if busiest is not None:
            oldest = next((scope for scope, held in self._waiting.items() if held == busiest), None)
            if oldest is None:
                return False
            del self._waiting[oldest]
            oldest.cancel()
        self._waiting[scope] = address
        return True

    def greet(self, scope: Waiting) -> None:
        """The connection said hello, so it keeps its place."""
        address = self._waiting.pop(scope, None)
        if address is not None:
            self._greeted[scope] = address

    def leave(self, scope: Waiting) -> None:
        """The connection is closed."""
        self._waiting.pop(scope, None)
        self._greeted.pop(scope, None)
