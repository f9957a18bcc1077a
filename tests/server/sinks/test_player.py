import contextlib
import json
import threading
import time
import types

import numpy as np
import pytest
from tests.server.sinks.receiving import RIG, Receiver, walking

from echoavatar.server.sinks import Frame, SinkGroup, SinkPlayer
from echoavatar.server.sinks import player as room
from echoavatar.server.sinks.player import FollowingClock, PoseTrack
from echoavatar.timing import SAMPLE_RATE_HZ as RATE
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.wire.blobs import Pose, pack_pose
from echoavatar.wire.messages import Flush


def followed(told, read_hz: float = 60.0, seconds: float = 4.0) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Readings, in seconds, of a clock that follows reports at 50 Hz."""
    clock, readings, next_told = FollowingClock(), [], 0.0
    for now in np.arange(0, seconds, 1 / read_hz):
        while next_told <= now:
            clock.tell(at := told(next_told) * RATE, next_told, at + 0.1 * RATE)
            next_told += 0.02
        readings.append(clock.read(now))
    return np.array(readings) / RATE


def test_without_a_report_there_is_no_reading() -> None:
    assert FollowingClock().read(1.0) is None


def test_an_uneven_clock_is_followed_evenly() -> None:
    noise = np.random.default_rng(0)
    readings = followed(lambda now: now + noise.uniform(-0.015, 0.015))
    speed = np.diff(readings) * 60
    assert np.abs(readings - np.arange(len(readings)) / 60).max() < 0.03
    assert speed.min() > 0.7
    assert speed.max() < 1.3


def test_the_clock_stops_with_the_other_one_and_never_runs_backwards() -> None:
    readings = followed(lambda now: min(now, 2.0))
    assert (np.diff(readings) >= 0).all()
    assert readings[-1] - readings[-30] < 0.002
    assert abs(readings[-1] - 2.0) < 0.25


def test_a_jump_is_made_at_once_in_both_directions() -> None:
    for to in (-1.5, 3.0):
        readings = followed(lambda now, to=to: now if now < 2 else now + to)
        settled = readings[int(2.2 * 60) :]
        expected = np.arange(len(readings))[int(2.2 * 60) :] / 60 + to
        assert np.abs(settled - expected).max() < 0.02


def test_an_error_of_a_fifth_of_a_second_is_made_up_within_one_without_a_jump() -> None:
    """The other clock is 0.2 s further at once, as after a pause of a player: the pace doubles until it is made up."""
    readings = followed(lambda now: now if now < 2 else now + 0.2)
    ahead = readings - np.arange(len(readings)) / 60
    assert np.diff(readings).max() * 60 < 2.1
    assert 0.05 < ahead[126] < 0.15
    assert ahead[156] == pytest.approx(0.2, abs=0.02)


def test_rare_reports_are_followed_evenly() -> None:
    """A player that reports its place eleven times a second."""
    clock, readings = FollowingClock(), []
    for frame in range(240):
        if frame % 5 == 0:
            clock.tell(at := frame / 60 * RATE, frame / 60, at + 0.1 * RATE)
        readings.append(clock.read(frame / 60))
    speed = np.diff(np.array(readings, float)) / RATE * 60
    assert speed.min() > 0.9
    assert speed.max() < 1.1


def test_the_clock_goes_as_far_as_the_other_one_may() -> None:
    clock = FollowingClock()
    clock.tell(0, 0.0, 0.25 * RATE)
    last = [clock.read(now) for now in np.arange(0, 3, 1 / 60)][-1]
    assert last == pytest.approx(0.25 * RATE, rel=0.05)


def ahead(track: PoseTrack, at: float) -> float:
    pose = track.read(at)
    assert pose is not None
    return float(pose.root[2])


def test_poses_are_read_between_frames_and_across_blocks() -> None:
    track = PoseTrack()
    assert track.read(0) is None
    track.put(0, walking(8))
    track.put(6400, walking(8, start=8 / 30))
    assert track.end == 12_800
    for at in (0, 100, 5599, 6000, 6399, 6400, 11_000):
        assert abs(ahead(track, at) - at / 24_000) < 1e-6
    assert ahead(track, -500) == 0
    assert abs(ahead(track, 99_999) - 15 / 30) < 1e-6  # held


def test_removed_poses_are_not_shown() -> None:
    track = PoseTrack()
    track.put(0, walking(8))
    track.put(6400, walking(8, start=8 / 30))
    track.cut(3 * SAMPLES_PER_FRAME)
    assert track.end == 3 * SAMPLES_PER_FRAME
    assert abs(ahead(track, 9_000) - 2 / 30) < 1e-6
    track.put(3 * SAMPLES_PER_FRAME, walking(8, start=5.0))
    assert abs(ahead(track, 4 * SAMPLES_PER_FRAME) - 5 - 1 / 30) < 1e-6


def test_poses_behind_the_reader_are_dropped() -> None:
    track = PoseTrack()
    for block in range(100):
        track.put(block * 6400, walking(8))
        track.read(block * 6400)
    assert len(track._frames) < 8 * 8


def test_quaternions_go_the_near_way_round() -> None:
    track, pose = PoseTrack(), walking(2)
    pose.rotations[1] *= -1
    track.put(0, pose)
    read = track.read(400)
    assert read is not None
    np.testing.assert_allclose(np.abs(read.rotations[:, 0]), 1, atol=1e-6)


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
        player.tell(at := start + passed * 24_000, time.monotonic(), at + 2_400)
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
        player.tell(block * 6400, time.monotonic(), block * 6400 + 2_400)
    assert time.monotonic() - began < 5  # the sink hangs for 20 s
    player.close()
    assert time.monotonic() - began < 10
    sink.let_go.set()


def test_a_recording_is_played_at_the_pace_of_the_wall() -> None:
    with (
        Receiver() as receiver,
        contextlib.closing(SinkGroup([f"json://127.0.0.1:{receiver.port}?rate=60"], RIG)) as group,
    ):
        began = time.monotonic()
        group.put(0, walking(30))
        group.finish()
        assert 0.9 < time.monotonic() - began < 6.0
        found = [json.loads(packet) for _, packet in receiver.packets(20)]
    places = [pose["root"][2] for pose in found if pose["type"] == "pose"]
    assert places == sorted(places)
    assert places[0] < 0.2


class Listener(FollowingClock):
    """A player that reads the clock it is told."""

    def put(self, at: int, pose: Pose) -> None:
        pass

    def close(self) -> None:
        pass


def test_motion_is_shown_a_tenth_of_a_second_after_it_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the next may come late by as much; then it goes at the pace of the wall, to its end."""
    monkeypatch.setattr(room, "time", types.SimpleNamespace(monotonic=lambda: 100.0))
    with contextlib.closing(SinkGroup([], RIG)) as group:
        group.players.append(listener := Listener())  # type: ignore[arg-type]
        group.put(0, walking(30))
        assert listener.read(100.08) == 0
        assert listener.read(100.6) == pytest.approx(0.5 * 24_000, abs=1)
        assert listener.read(109.0) == 24_000


def test_a_session_may_be_taken_back() -> None:
    with contextlib.closing(SinkGroup([], RIG)) as group:
        group.take(pack_pose(walking(300), at=0))
        group.take(Flush(at=2_400, epoch=1, seg=0, heard=0))
        began = time.monotonic()
        group.finish()
        assert time.monotonic() - began < 5


def test_several_sinks_are_shown_the_same() -> None:
    with Receiver() as a, Receiver() as b:
        sinks = [f"json://127.0.0.1:{a.port}", f"livelink://127.0.0.1:{b.port}"]
        with contextlib.closing(SinkGroup(sinks, RIG)) as group:
            group.put(0, walking(60))  # two seconds, because a busy machine skips frames
            group.finish()
            assert json.loads(a.until(lambda packet: b'"pose"' in packet))["type"] == "pose"
            assert len(b.packets(1)[0][1]) > 290
        assert all(player.shown > 3 for player in group.players)
