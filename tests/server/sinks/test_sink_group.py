import contextlib
import json
import queue
import time

import pytest
from tests.server.sinks.receiving import RIG, Receiver, walking

from echoavatar.server.sinks import SinkGroup, sink_group
from echoavatar.wire import Flush, Pose, pack_pose


def test_a_recording_is_played_at_the_pace_of_the_wall() -> None:
    with Receiver() as receiver, SinkGroup([f"json://127.0.0.1:{receiver.port}?rate=60"], RIG) as group:
        began = time.monotonic()
        group.put(0, walking(30))
        group.finish()
        assert 0.9 < time.monotonic() - began < 6.0
        found = [json.loads(packet) for _, packet in receiver.packets(20)]
    places = [pose["root"][2] for pose in found if pose["type"] == "pose"]
    assert places == sorted(places)
    assert places[0] < 0.2


class Watch:
    """A clock that stands until it is set, in the place of the module `time`."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


class Listener:
    """A player that notes the sample it is told."""

    def __init__(self) -> None:
        self.told: queue.Queue[float] = queue.Queue(1)

    def put(self, at: int, pose: Pose) -> None:
        pass

    def tell(self, at: float, now: float) -> None:
        with contextlib.suppress(queue.Full):
            self.told.put_nowait(at)

    def latest(self) -> float:
        """What it is told from now on; the first two may be older."""
        return [self.told.get(timeout=10) for _ in range(3)][-1]

    def close(self) -> None:
        pass


def test_motion_is_shown_a_tenth_of_a_second_after_it_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the next may come late by as much; then it goes at the pace of the wall."""
    watch, listener = Watch(), Listener()
    monkeypatch.setattr(sink_group, "time", watch)
    with SinkGroup([], RIG) as group:
        group.players.append(listener)  # type: ignore[arg-type]
        group.put(0, walking(30))
        watch.now = 100.08
        assert listener.latest() == 0
        watch.now = 100.6
        assert listener.latest() == pytest.approx(0.5 * 24_000, abs=1)


def test_a_session_may_be_taken_back() -> None:
    with SinkGroup([], RIG) as group:
        group.take(pack_pose(walking(300), at=0))
        group.take(Flush(at=2_400, epoch=1, seg=0, heard=0))
        began = time.monotonic()
        group.finish()
        assert time.monotonic() - began < 5


def test_several_sinks_are_shown_the_same() -> None:
    with Receiver() as a, Receiver() as b:
        sinks = [f"json://127.0.0.1:{a.port}", f"livelink://127.0.0.1:{b.port}"]
        with SinkGroup(sinks, RIG) as group:
            group.put(0, walking(60))  # two seconds, because a busy machine skips frames
            group.finish()
            assert json.loads(a.until(lambda packet: b'"pose"' in packet))["type"] == "pose"
            assert len(b.packets(1)[0][1]) > 290
        assert all(player.shown > 3 for player in group.players)
