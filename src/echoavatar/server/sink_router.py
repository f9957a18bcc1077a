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

    def follow(self, sessions: Iterable[ServerSession]) -> None:
        """Show the oldest of the sessions, and tell where its playhead is; called after each event of a session."""
        oldest = next(iter(sessions), None)
        if not self._players or oldest is None:
            self._shown = None
            return
        if oldest is not self._shown:
            self._shown = oldest
            for player in self._players:
                player.begin()
            oldest.join(Relay(self._take, lambda: oldest.source is not None), received=None)
        sample, until, now = oldest.place, oldest.waits_at, time.monotonic()
        for player in self._players:
            player.tell(sample, now, until)

    def close(self) -> None:
        """Stop all players."""
        for player in self._players:
            player.close()
        self._players.clear()

    def _take(self, message: ServerMessage) -> None:
        for player in self._players:
            player.take(message)
