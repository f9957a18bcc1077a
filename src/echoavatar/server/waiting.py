"""The queue before a full server. Clients hold no connection in it: they come back with their ticket."""

import time

RETRY_S = 2.0  # after which who waits should come back
PATIENCE_S = 4 * RETRY_S  # after which who did not has left
MOST = 100  # tickets; further clients have no place


class WaitingList:
    """The tickets of those who wait, the first first, with the times at which they were last seen."""

    def __init__(self) -> None:
        self._seen: dict[str, float] = {}

    def place(self, ticket: str) -> int:
        """The place of a ticket, from 1 on; who comes without one, or too late, is behind all."""
        now = time.monotonic()
        self._seen = {other: at for other, at in self._seen.items() if now - at < PATIENCE_S}
        if ticket and (ticket in self._seen or len(self._seen) < MOST):
            self._seen[ticket] = now
        order = list(self._seen)
        return order.index(ticket) + 1 if ticket in self._seen else len(order) + 1

    def leave(self, ticket: str) -> None:
        """The owner of a ticket has a seat."""
        self._seen.pop(ticket, None)
