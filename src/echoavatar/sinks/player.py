"""A sink and the thread that plays motion into it, at the sink's rate and on its own clock."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from ..timing import SAMPLES_PER_FRAME
from ..wire import Flush, Motion, Pose, Rig, ServerMessage, unpack_pose
from .clock import FollowingClock
from .sink import Frame, Sink
from .track import PoseTrack

_LOG = logging.getLogger(__name__)
JOIN_TIMEOUT_S = 1.0
INBOX = 1_000  # messages that a sink may leave lying, the oldest are then lost


class SinkPlayer:
    """Fed with messages of a session and told its clock from any thread; neither ever waits for the sink."""

    def __init__(self, sink: Sink, rig: Rig, *, curves: int = 52, name: str = "sink") -> None:
        """`rig` and `curves` say how motion messages are to be read."""
        self.shown, self.failed = 0, 0
        self._sink, self._name = sink, name
        self._joints, self._curves = len(rig.names), curves
        self._clock, self._track = FollowingClock(), PoseTrack()
        self._inbox = deque[Motion | Flush | tuple[int, Pose] | None](maxlen=INBOX)
        self._told: tuple[float, float] | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name=f"sink {name}", daemon=True)
        self._thread.start()

    def take(self, message: ServerMessage) -> None:
        """One message of a session; those of no concern are passed over."""
        if isinstance(message, Motion | Flush):
            self._inbox.append(message)

    def put(self, at: int, pose: Pose) -> None:
        """Frames from `at` on, in samples of the session's clock."""
        self._inbox.append((at, pose))

    def tell(self, at: float, now: float) -> None:
        """What is heard at the time `now` (`time.monotonic`)."""
        self._told = at, now

    def begin(self) -> None:
        """Another session, or from the start: forget what was there; the pose on screen stays until motion comes."""
        self._told = None
        self._inbox.append(None)

    def close(self) -> None:
        """Stop the thread; one that hangs in its sink is left behind."""
        self._stop.set()
        self._thread.join(JOIN_TIMEOUT_S)

    def _play(self) -> None:
        began = due = time.monotonic()
        held: Pose | None = None
        at = 0
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + 1 / self._sink.rate, now)  # frames that are late are left out
            self._hear()
            moment = self._clock.read(now)
            pose = None if moment is None else self._track.read(moment)
            if pose is not None and moment is not None:
                last = self._track.end - SAMPLES_PER_FRAME  # is held beyond it
                held, at = pose, round(min(moment, last))
            if held is not None:
                self._show(Frame(held.rotations, held.root, held.face, now - began, at))
        self._quietly(self._sink.close)

    def _hear(self) -> None:
        """What was put in the inbox, on this thread: nobody else waits for it."""
        while self._inbox:
            match self._inbox.popleft():
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
        """Do it; whatever goes wrong is the sink's own affair, said once."""
        try:
            what()
        except Exception as error:
            self.failed += 1
            if self.failed == 1:
                _LOG.warning("%s does not take motion (%s); the session goes on without", self._name, error)
            return False
        return True
