"""Plays motion into sinks, each on a thread of its own, at its own rate and on a clock of its own.

After each event of a session, its playhead is told: where it is, and where it will wait. `FollowingClock` runs on its
own and is corrected towards it by running a little faster or slower, so that motion neither stutters nor drifts. It
stops when the other clock stops, and never runs backwards except in a jump. `SinkGroup` plays where nobody reports a
position.
"""

import logging
import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import Pose, unpack_pose
from echoavatar.wire.messages import Flush, Motion, Rig, ServerMessage

from .encoders import Frame
from .sink import UdpSink, make_sink

CORRECTION_S = 0.1  # an error this large doubles the clock's speed, or stops the clock
JUMP_S = 0.35  # a larger error is corrected at once
HISTORY_SAMPLES = 24_000  # samples kept behind the last reading
_LOG = logging.getLogger(__name__)
JOIN_TIMEOUT_S = 1.0
MAX_QUEUED = 1_000  # messages kept for the thread; when full, the oldest are dropped
LEAD_S = 0.1  # from the first motion until it is shown; absorbs uneven arrival


Report = tuple[float, float, float]  # a sample, the time at which it is shown, and the sample at which the clock waits


class FollowingClock:
    """Follows a session's clock; readings are in samples."""

    def __init__(self) -> None:
        self._told: Report | None = None
        self._read: tuple[float, float] | None = None

    def tell(self, at: float, now: float, until: float) -> None:
        """Report that the other clock shows `at` at the time `now` (`time.monotonic`), and waits when it is `until`."""
        self._told = at, now, until

    def read(self, now: float) -> float | None:
        """The sample to show now; None before the first report."""
        if self._told is None:
            return None
        at, then, until = self._told
        goal = min(at + max(now - then, 0.0) * SAMPLE_RATE_HZ, max(at, until))
        if self._read is None or abs(goal - self._read[0]) > JUMP_S * SAMPLE_RATE_HZ:
            self._read = goal, now
            return goal
        mine, before = self._read
        passed = max(0.0, now - before) * SAMPLE_RATE_HZ
        error = (goal - (mine + passed)) / (CORRECTION_S * SAMPLE_RATE_HZ)
        mine = min(mine + passed * min(max(1 + error, 0.0), 2.0), max(mine, until))
        self._read = mine, now
        return mine


class PoseTrack:
    """Motion that is still to be shown. The writer bounds its length; poses behind the reader are dropped."""

    def __init__(self) -> None:
        self._frames: deque[tuple[int, Pose]] = deque()  # one frame each, with its clock

    @property
    def end(self) -> int:
        """The clock up to which there are poses; 0 if there are none."""
        return self._frames[-1][0] + SAMPLES_PER_FRAME if self._frames else 0

    def put(self, at: int, pose: Pose) -> None:
        """Add frames from `at` on; they replace existing poses from that moment on."""
        self.cut(at)
        self._frames.extend((at + k * SAMPLES_PER_FRAME, _frame(pose, k)) for k in range(len(pose.root)))

    def cut(self, at: int) -> None:
        """Remove all poses from `at` on."""
        while self._frames and self._frames[-1][0] >= at:
            self._frames.pop()

    def read(self, at: float) -> Pose | None:
        """The pose at a moment, interpolated between the two frames around it; beyond either end, the nearest frame."""
        while len(self._frames) > 1 and self._frames[1][0] < at - HISTORY_SAMPLES:
            self._frames.popleft()
        if not self._frames:
            return None
        following = bisect_right(self._frames, at, key=lambda frame: frame[0])
        before = self._frames[max(following - 1, 0)]
        after = self._frames[min(following, len(self._frames) - 1)]
        share = 0.0 if after[0] <= before[0] else (at - before[0]) / (after[0] - before[0])
        return _interpolate(before[1], after[1], share)


def _frame(pose: Pose, k: int) -> Pose:
    return Pose(pose.rotations[k], pose.root[k], None if pose.face is None else pose.face[k])


def _interpolate(a: Pose, b: Pose, share: float) -> Pose:
    """Interpolate linearly, quaternions along the shorter arc and normalised."""
    signs = np.where(np.einsum("jc,jc->j", a.rotations, b.rotations) < 0, -share, share)[:, None]
    rotations: Float[np.ndarray, "j 4"] = a.rotations * (1 - share) + b.rotations * signs
    rotations = rotations / np.maximum(np.sqrt(np.einsum("jc,jc->j", rotations, rotations)), 1e-9)[:, None]
    face = None if a.face is None or b.face is None else a.face * (1 - share) + b.face * share
    return Pose(rotations, a.root * (1 - share) + b.root * share, face)


class SinkPlayer:
    """Plays a session into a sink. Messages and clock reports may come from any thread, and never wait for the sink."""

    def __init__(self, sink: UdpSink, rig: Rig, *, name: str = "sink") -> None:
        """`rig` is that of the motion messages."""
        self.shown, self.failed = 0, 0
        self._sink, self._name = sink, name
        self._joints, self._clock, self._track = len(rig.names), FollowingClock(), PoseTrack()
        self._queue = deque[Motion | Flush | tuple[int, Pose] | None](maxlen=MAX_QUEUED)
        self._told: Report | None = None
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

    def tell(self, at: float, now: float, until: float) -> None:
        """Report the playhead, see `FollowingClock.tell`."""
        self._told = at, now, until

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
                self.shown += self._quietly(self._sink.send, Frame(*held, now - began, at))
        self._quietly(self._sink.close)

    def _hear(self) -> None:
        """Process the queue; runs on the sink's thread."""
        while self._queue:
            match self._queue.popleft():
                case None:
                    self._track, self._clock = PoseTrack(), FollowingClock()
                case Flush(at=at):
                    self._track.cut(at)
                case Motion() as motion:
                    self._place(motion.at, unpack_pose(motion, joints=self._joints))
                case (at, pose):
                    self._place(at, pose)
        if self._told is not None:
            self._clock.tell(*self._told)

    def _place(self, at: int, pose: Pose) -> None:
        face = None if pose.face is None else self._sink.faces(pose.face)
        self._track.put(at, pose._replace(face=face))

    def _quietly(self, what: Callable[..., None], *given: Frame) -> bool:
        """Call `what`; the first failure is logged, and none is raised."""
        try:
            what(*given)
        except Exception as error:
            self.failed += 1
            if self.failed == 1:
                _LOG.warning("%s cannot show motion (%s); the session continues without it", self._name, error)
            return False
        return True


class SinkGroup:
    """Plays motion into several sinks when no player reports a playback position."""

    def __init__(self, sinks: Iterable[str], rig: Rig) -> None:
        """Raises EchoAvatarError if an address is not valid."""
        made = [(text, make_sink(text, rig)) for text in sinks]
        self.players = [SinkPlayer(sink, rig, name=text) for text, sink in made]
        self._start: tuple[int, float] | None = None  # a sample, and the time at which it is shown
        self._end = 0

    def take(self, message: ServerMessage) -> None:
        """Take a message of a session."""
        if isinstance(message, Motion):
            self._reach(message.at + message.frames * SAMPLES_PER_FRAME, message.at)
        elif isinstance(message, Flush):
            self._reach(min(self._end, message.at))
        for player in self.players:
            player.take(message)

    def put(self, at: int, pose: Pose) -> None:
        """Take frames at 30 fps that begin at sample `at`."""
        self._reach(at + len(pose.root) * SAMPLES_PER_FRAME, at)
        for player in self.players:
            player.put(at, pose)

    def finish(self) -> None:
        """Wait until everything has been shown."""
        if self.players and self._start is not None:
            at, since = self._start
            time.sleep(max(0.0, since + (self._end - at) / SAMPLE_RATE_HZ - time.monotonic()))

    def close(self) -> None:
        """Stop all sinks."""
        for player in self.players:
            player.close()

    def _reach(self, end: int, at: int | None = None) -> None:
        """There is motion up to `end`; the first that comes, at sample `at`, starts the clock."""
        self._end = end
        if self._start is None and at is not None:
            self._start = at, time.monotonic() + LEAD_S
        if self._start is not None:
            for player in self.players:
                player.tell(*self._start, end)
