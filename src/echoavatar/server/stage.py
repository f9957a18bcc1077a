"""Sinks of a server: programs beside the browsers that show one session's avatar, the first that there is.

A stage is one more listener of that session, so it hears of its motion and its flushes; when the session is over
the next one comes on. Sinks have threads of their own: nothing here waits for them.
"""

from collections.abc import Iterable, Sequence

from ..sinks import SinkPlayer, make_sink
from ..wire import Rig, ServerMessage
from .live import LiveSession
from .outbox import Outbox


class StageBox(Outbox):
    """Hands what a session says to the players at once; counts as someone who watches."""

    def __init__(self, players: Sequence[SinkPlayer], live: LiveSession) -> None:
        super().__init__(("motion",))
        self._players, self._live = players, live

    @property
    def plays(self) -> bool:
        """While there is a source: one that was lost finds its session where it left it."""
        return self._live.source is not None

    def put(self, message: ServerMessage) -> None:
        """To all players; nothing is queued."""
        for player in self._players:
            player.take(message)


class Stage:
    """The players, and the session they show."""

    def __init__(self, sinks: Iterable[str], rig: Rig) -> None:
        """Raises EchoAvatarError for an address that is none."""
        made = [(text, make_sink(text, rig)) for text in sinks]
        self._players = [SinkPlayer(sink, rig, name=text) for text, sink in made]
        self._shown: tuple[LiveSession, StageBox] | None = None

    def show(self, sessions: Iterable[LiveSession], now: float) -> None:
        """Go on with the session that is shown, or take the first; called with the server's beat."""
        if not self._players:
            return
        there = list(sessions)
        if self._shown is not None and self._shown[0] not in there:
            self._shown = None
        if self._shown is None and there:
            self._enter(there[0])
        if self._shown is not None:
            sample = self._shown[0].playhead.sample
            for player in self._players:
                player.tell(sample, now)

    def close(self) -> None:
        """Stop all players."""
        for player in self._players:
            player.close()

    def _enter(self, live: LiveSession) -> None:
        for player in self._players:
            player.begin()
        box = StageBox(self._players, live)
        live.join(box, received=None)
        self._shown = live, box
