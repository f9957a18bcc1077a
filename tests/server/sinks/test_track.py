import numpy as np
from tests.server.sinks.receiving import walking

from echoavatar.server.sinks.track import PoseTrack
from echoavatar.timing import SAMPLES_PER_FRAME


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
    assert len(track._blocks) < 8


def test_quaternions_go_the_near_way_round() -> None:
    track, pose = PoseTrack(), walking(2)
    pose.rotations[1] *= -1
    track.put(0, pose)
    read = track.read(400)
    assert read is not None
    np.testing.assert_allclose(np.abs(read.rotations[:, 0]), 1, atol=1e-6)
