import threading
import time

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, walking

from echoavatar.server.sinks import Frame, SinkPlayer
from echoavatar.wire import Flush, pack_pose


class Noted:
    """A sink that records its frames."""

    def __init__(self, rate: float = 60.0) -> None:
        self.rate = rate
        self.frames: list[Frame] = []
        self.is_closed = False

    def faces(self, curves: np.ndarray) -> np.ndarray:
        return curves

    def send(self, frame: Frame) -> None:
        self.frames.append(frame)

    def close(self) -> None:
        self.is_closed = True


class Broken(Noted):
    def send(self, frame: Frame) -> None:
        super().send(frame)
        raise OSError("the network is down")


class Stuck(Noted):
    """A sink that hangs in its first frame."""

    def __init__(self) -> None:
        super().__init__()
        self.let_go = threading.Event()

    def send(self, frame: Frame) -> None:
        self.let_go.wait(20)


def played(player: SinkPlayer, seconds: float, *, start: int = 0) -> None:
    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds:
        player.tell(start + passed * 24_000, time.monotonic())
        time.sleep(0.01)


@pytest.mark.parametrize("rate", [20.0, 60.0])
def test_frames_come_at_the_sinks_own_rate_on_the_sessions_clock(rate: float) -> None:
    sink = Noted(rate)
    player = SinkPlayer(sink, RIG)
    player.put(0, walking(60))
    played(player, 1.0)
    player.close()
    assert 0.2 * rate < len(sink.frames) < 1.2 * rate  # a busy machine skips some
    for frame in sink.frames:
        assert abs(frame.root[2] - frame.at / 24_000) < 1e-4  # each frame shows the pose of its own moment
    times = [frame.seconds for frame in sink.frames]
    assert all(b > a for a, b in zip(times, times[1:], strict=False))
    assert sink.is_closed


def test_messages_of_a_session_are_enough_and_a_flush_is_obeyed() -> None:
    sink = Noted()
    player = SinkPlayer(sink, RIG)
    player.take(pack_pose(walking(30), at=0))
    played(player, 0.2)
    player.take(Flush(at=8_000, epoch=1, seg=0, heard=0))
    played(player, 0.1, start=8_000)  # poses after the flush are not shown, although no new ones have arrived
    player.take(pack_pose(walking(30, start=100.0), at=8_000, epoch=1))
    played(player, 0.3, start=8_000)
    player.close()
    for frame in sink.frames:
        is_blend = 7_200 <= frame.at <= 8_000  # between the last frame before the flush and the first one after it
        if not is_blend:
            beyond = 100 if frame.at > 8_000 else 0
            ahead = (frame.at - (8_000 if beyond else 0)) / 24_000
            assert abs(frame.root[2] - beyond - ahead) < 1e-4
    assert sink.frames[0].at < 7_200
    assert sink.frames[-1].at > 8_000


def test_between_sessions_the_last_pose_is_held() -> None:
    sink = Noted()
    player = SinkPlayer(sink, RIG)
    player.put(0, walking(30))
    played(player, 0.3)
    player.begin()
    seen, began = len(sink.frames), time.monotonic()
    while len(sink.frames) <= seen + 5 and time.monotonic() - began < 10:
        time.sleep(0.05)
    player.close()
    assert len(sink.frames) > seen + 5
    assert sink.frames[-1].root[2] == sink.frames[seen].root[2]


def test_a_failing_sink_is_logged_once_and_tried_again(caplog: pytest.LogCaptureFixture) -> None:
    sink = Broken()
    player = SinkPlayer(sink, RIG, name="vmc://there")
    player.put(0, walking(60))
    played(player, 0.4)
    player.close()
    assert player.failed == len(sink.frames) > 2
    assert [record for record in caplog.messages if "vmc://there" in record] == caplog.messages[:1]
    assert len(caplog.messages) == 1


def test_a_sink_that_hangs_blocks_nothing() -> None:
    sink = Stuck()
    player = SinkPlayer(sink, RIG)
    player.put(0, walking(30))
    played(player, 0.1)
    began = time.monotonic()
    for block in range(200):
        player.put(block * 6400, walking(8))
        player.tell(block * 6400, time.monotonic())
    assert time.monotonic() - began < 5  # the sink hangs for 20 s
    player.close()
    assert time.monotonic() - began < 10
    sink.let_go.set()
