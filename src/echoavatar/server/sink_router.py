"""Sends one session's motion to the server's sinks: other programs that show the avatar beside the browsers.

The router shows the oldest session, as one more listener of it, and turns to the next when it is over. Sinks have
threads of their own; nothing here waits for them.
"""

import time
from collections.abc import Iterable

from echoavatar.wire.messages import Rig, ServerMessage

from .outbox import Relay
from .session import ServerSession
from .sinks import SinkPlayer, make_sink


class SinkRouter:
    """The players, and the session they show."""

    def __init__(self, sinks: Iterable[str], rig: Rig) -> None:
        """Raises EchoAvatarError for an invalid address."""
        made = [(text, make_sink(text, rig)) for text in sinks]
        self._players = [SinkPlayer(sink, rig, name=text) for text, sink in made]
        self._shown: ServerSession | None = None

    def show(self, sessions: Iterable[ServerSession]) -> None:
        """Report the playhead of the session that is shown; show the first session once that one is over."""
        if not self._players:
            return
        there = list(sessions)
        if self._shown not in there:
            self._shown = there[0] if there else None
            if there:
                self._begin(there[0])
        if self._shown is not None:
            sample, now = self._shown.place, time.monotonic()
            for player in self._players:
                player.tell(sample, now)

    def close(self) -> None:
        """Stop all players."""
        for player in self._players:
            player.close()

    def _begin(self, session: ServerSession) -> None:
        for player in self._players:
            player.begin()
        session.join(Relay(self._take, lambda: session.source is not None), received=None)

    def _take(self, message: ServerMessage) -> None:
        for player in self._players:
            player.take(message)
