"""Sends one session's motion to the server's sinks: other programs that show the avatar beside the browsers.

The router shows the oldest session, as one more listener of it, and turns to the next when it is over. Sinks have
threads of their own; nothing here waits for them.
"""

from collections.abc import Iterable, Sequence

from echoavatar.wire import Rig, ServerMessage

from .outbox import Outbox
from .session import ServerSession
from .sinks import SinkPlayer, make_sink


class SinkOutbox(Outbox):
    """Passes a session's messages to the players at once. The session counts it as a client that plays."""

    def __init__(self, players: Sequence[SinkPlayer], session: ServerSession) -> None:
        super().__init__(("motion",))
        self._players, self._session = players, session

    @property
    def plays(self) -> bool:
        """Only while the session has a source: a source that returns finds its session where it left it."""
        return self._session.source is not None

    def put(self, message: ServerMessage) -> None:
        """Pass a message to all players; nothing is queued."""
        for player in self._players:
            player.take(message)


class SinkRouter:
    """The players, and the session they show."""

    def __init__(self, sinks: Iterable[str], rig: Rig) -> None:
        """Raises EchoAvatarError for an invalid address."""
        made = [(text, make_sink(text, rig)) for text in sinks]
        self._players = [SinkPlayer(sink, rig, name=text) for text, sink in made]
        self._shown: tuple[ServerSession, SinkOutbox] | None = None

    def show(self, sessions: Iterable[ServerSession], now: float) -> None:
        """Go on with the session that is shown, or turn to the first; called with the server's clock."""
        if not self._players:
            return
        there = list(sessions)
        if self._shown is not None and self._shown[0] not in there:
            self._shown = None
        if self._shown is None and there:
            self._enter(there[0])
        if self._shown is not None:
            sample = self._shown[0].place
            for player in self._players:
                player.tell(sample, now)

    def close(self) -> None:
        """Stop all players."""
        for player in self._players:
            player.close()

    def _enter(self, session: ServerSession) -> None:
        for player in self._players:
            player.begin()
        box = SinkOutbox(self._players, session)
        session.join(box, received=None)
        self._shown = session, box
