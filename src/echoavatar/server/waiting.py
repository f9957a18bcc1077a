"""The queue before a full server. Clients hold no connection in it: they come back with their ticket."""

import time

RETRY_S = 2.0  # a waiting client should ask again after this time
PATIENCE_S = 4 * RETRY_S  # a client that has not asked for so long has left
MOST = 100  # tickets; further clients have no place


class WaitingList:
    """The tickets of waiting clients, the longest waiting first, and when each was last seen."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}

    def place(self, ticket: str) -> int:
        """The place of a ticket, from 1 on. A client without one, or beyond `MOST`, is behind all."""
        now = time.monotonic()
        self._seen = {other: at for other, at in self._seen.items() if now - at < PATIENCE_S}
        if ticket and (ticket in self._seen or len(self._seen) < MOST):
            self._seen[ticket] = now
        order = list(self._seen)
        return order.index(ticket) + 1 if ticket in self._seen else len(order) + 1

    def leave(self, ticket: str) -> None:
        """Remove the ticket of a client that got a seat."""
        self._seen.pop(ticket, None)
