"""Several sinks that show the same motion, on a clock that starts with the first motion and follows real time."""

import threading
import time
from collections.abc import Iterable
from types import TracebackType

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire import Flush, Motion, Pose, Rig, ServerMessage

from .address import make_sink
from .player import SinkPlayer

POLL_S = 0.02
LEAD_S = 0.1  # from the first motion until it is shown; absorbs uneven arrival


class SinkGroup:
    """Plays motion into several sinks when no player reports a playback position."""

    def __init__(self, sinks: Iterable[str], rig: Rig, *, curves: int = 52) -> None:
        """Raises EchoAvatarError if an address is not valid."""
        made = [(text, make_sink(text, rig)) for text in sinks]
        self.players = [SinkPlayer(sink, rig, curves=curves, name=text) for text, sink in made]
        self._start: tuple[int, float] | None = None  # a sample, and the time at which it is shown
        self._end = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._tick, name="sinks' clock", daemon=True)
        self._thread.start()

    def take(self, message: ServerMessage) -> None:
        """Take a message of a session."""
        if isinstance(message, Motion):
            self._reach(message.at, message.frames)
        elif isinstance(message, Flush):
            self._end = min(self._end, message.at)
        for player in self.players:
            player.take(message)

    def put(self, at: int, pose: Pose) -> None:
        """Take frames at 30 fps that begin at sample `at`."""
        self._reach(at, len(pose.root))
        for player in self.players:
            player.put(at, pose)

    def finish(self) -> None:
        """Wait until everything has been shown."""
        while self.players and (at := self._now()) is not None and at < self._end:
            time.sleep(POLL_S)

    def close(self) -> None:
        """Stop all sinks."""
        self._stop.set()
        self._thread.join()
        for player in self.players:
            player.close()

    def __enter__(self) -> "SinkGroup":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _reach(self, at: int, frames: int) -> None:
        self._end = at + frames * SAMPLES_PER_FRAME
        if self._start is None:
            self._start = at, time.monotonic() + LEAD_S

    def _now(self) -> float | None:
        if self._start is None:
            return None
        return self._start[0] + max(0.0, time.monotonic() - self._start[1]) * SAMPLE_RATE_HZ

    def _tick(self) -> None:
        while not self._stop.wait(POLL_S):
            at = self._now()
            if at is not None:
                for player in self.players:
                    player.tell(min(at, self._end), time.monotonic())
