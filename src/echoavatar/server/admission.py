"""Admission of WebSockets. A connection that has not said `hello` gives way to a new one."""

from collections import Counter

from anyio import CancelScope


class Admission:
    """Open connections, at most `limit`. Each is known by the scope in which it waits for its hello."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._greeted: set[CancelScope] = set()
        self._waiting: dict[CancelScope, str] = {}  # with the client's address, the oldest first

    def __len__(self) -> int:
        return len(self._greeted) + len(self._waiting)

    def enter(self, scope: CancelScope, address: str) -> bool:
        """Admit a connection; returns False if there is no room.

        At the limit, the address with the most connections without hello loses its oldest.
        """
        if len(self) >= self._limit:
            if not self._waiting:
                return False
            crowd, _ = Counter(self._waiting.values()).most_common(1)[0]
            oldest = next(scope for scope, address in self._waiting.items() if address == crowd)
            del self._waiting[oldest]
            oldest.cancel()
        self._waiting[scope] = address
        return True

    def greet(self, scope: CancelScope) -> None:
        """The connection said hello and stays."""
        if self._waiting.pop(scope, None) is not None:
            self._greeted.add(scope)

    def leave(self, scope: CancelScope) -> None:
        """The connection is closed."""
        self._waiting.pop(scope, None)
        self._greeted.discard(scope)
