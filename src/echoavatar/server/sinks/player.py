"""A thread that plays motion into a sink, at the sink's rate and on a clock of its own."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.wire import Flush, Motion, Pose, Rig, ServerMessage, unpack_pose

from .clock import FollowingClock
from .sink import Frame, Sink
from .track import PoseTrack

_LOG = logging.getLogger(__name__)
JOIN_TIMEOUT_S = 1.0
MAX_QUEUED = 1_000  # messages kept for the thread; when full, the oldest are dropped


class SinkPlayer:
    """Plays a session into a sink. Messages and clock reports may come from any thread, and never wait for the sink."""

    def __init__(self, sink: Sink, rig: Rig, *, curves: int = 52, name: str = "sink") -> None:
        """`rig` and `curves` describe the motion messages."""
        self.shown, self.failed = 0, 0
        self._sink, self._name = sink, name
        self._joints, self._curves = len(rig.names), curves
        self._clock, self._track = FollowingClock(), PoseTrack()
        self._queue = deque[Motion | Flush | tuple[int, Pose] | None](maxlen=MAX_QUEUED)
        self._told: tuple[float, float] | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name=f"sink {name}", daemon=True)
        self._thread.start()

    def take(self, message: ServerMessage) -> None:
        """Take one message of a session; messages other than motion and flushes are ignored."""
        if isinstance(message, Motion | Flush):
            self._queue.append(message)

    def put(self, at: int, pose: Pose) -> None:
        """Take frames that begin at `at`, in samples of the session's clock."""
        self._queue.append((at, pose))

    def tell(self, at: float, now: float) -> None:
        """Report the sample `at` that is heard at the time `now` (`time.monotonic`)."""
        self._told = at, now

    def begin(self) -> None:
        """Start another session; the last pose stays visible until motion arrives."""
        self._told = None
        self._queue.append(None)

    def close(self) -> None:
        """Stop the thread; a thread that hangs in its sink is abandoned."""
        self._stop.set()
        self._thread.join(JOIN_TIMEOUT_S)

    def _play(self) -> None:
        began = due = time.monotonic()
        held: Pose | None = None
        at = 0
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + 1 / self._sink.rate, now)  # late frames are skipped
            self._hear()
            moment = self._clock.read(now)
            pose = None if moment is None else self._track.read(moment)
            if pose is not None and moment is not None:
                last = self._track.end - SAMPLES_PER_FRAME  # the last pose is held beyond it
                held, at = pose, round(min(moment, last))
            if held is not None:
                self._show(Frame(held.rotations, held.root, held.face, now - began, at))
        self._quietly(self._sink.close)

    def _hear(self) -> None:
        """Process what is queued; runs on the sink's thread."""
        while self._queue:
            match self._queue.popleft():
                case None:
                    self._track, self._clock = PoseTrack(), FollowingClock()
                case Flush(at=at):
                    self._track.cut(at)
                case Motion() as motion:
                    self._place(motion.at, unpack_pose(motion, joints=self._joints, curves=self._curves))
                case (at, pose):
                    self._place(at, pose)
        if self._told is not None:
            self._clock.tell(*self._told)

    def _place(self, at: int, pose: Pose) -> None:
        face = None if pose.face is None else self._sink.faces(pose.face)
        self._track.put(at, pose._replace(face=face))

    def _show(self, frame: Frame) -> None:
        if self._quietly(lambda: self._sink.send(frame)):
            self.shown += 1

    def _quietly(self, what: Callable[[], None]) -> bool:
        """Run `what`; the first failure is logged, and none is passed on."""
        try:
            what()
        except Exception as error:
            self.failed += 1
            if self.failed == 1:
                _LOG.warning("%s cannot show motion (%s); the session continues without it", self._name, error)
            return False
        return True
