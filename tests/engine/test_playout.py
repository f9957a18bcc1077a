import numpy as np

from echoavatar.engine.music import Heard
from echoavatar.engine.playout import PlayoutBuffer, first_frame_after
from echoavatar.motion.motion_chunk import MotionChunk

SILENCE = Heard(np.zeros(6_400, np.float32), None)


def turned(degrees: float, speed: float = 0.0) -> MotionChunk:
    """Eight frames about Y, beginning at an angle and turning by `speed` degrees a frame."""
    half = np.radians(degrees + speed * np.arange(8)) / 2
    rotations = np.zeros((8, 52, 4), np.float32)
    rotations[..., 0], rotations[..., 2] = np.cos(half)[:, None], np.sin(half)[:, None]
    return MotionChunk(rotations, np.zeros((8, 3), np.float32))


def angle(motion: MotionChunk) -> np.ndarray:
    return np.degrees(2 * np.arctan2(motion.rotations[:, 0, 2], motion.rotations[:, 0, 0]))


def test_the_first_frame_after_a_sample_is_not_before_it() -> None:
    assert [first_frame_after(sample) for sample in (0, 1, 800, 801)] == [0, 1, 1, 2]


def test_new_motion_takes_over_from_the_pose_and_speed_on_screen() -> None:
    """Turning by 2 degrees a frame when cut after frame 3; the new motion stands still at 40 degrees."""
    buffer = PlayoutBuffer()
    buffer.show(0, turned(0, 2), SILENCE, "speech", epoch=0, memory=5)
    assert buffer.take() is not None
    buffer.go_back(4 * 800)
    buffer.show(0, turned(40), SILENCE, "idle", epoch=0, memory=5)
    for chunk in (1, 2):
        buffer.show(chunk, turned(40), SILENCE, "idle", epoch=0, memory=5)
    shown = []
    while (delivery := buffer.take()) is not None:
        shown.append(delivery)
    assert [delivery.start for delivery in shown] == [3_200, 6_400, 12_800]
    path = np.concatenate([[4, 6], *(angle(delivery.motion) for delivery in shown)])
    np.testing.assert_allclose(path[-8:], 40, atol=1e-3)
    assert np.abs(np.diff(path, 2)).max() < 8  # degrees a frame, per frame: no jump, no kink


def test_one_frame_left_coasts_and_none_left_waits() -> None:
    for sample, first in ((5_600, 5_600), (6_000, 6_400)):
        buffer = PlayoutBuffer()
        buffer.show(0, turned(0, 2), SILENCE, "speech", epoch=0, memory=5)
        buffer.take()
        buffer.go_back(sample)
        buffer.show(0, turned(90), SILENCE, "idle", epoch=0, memory=5)
        buffer.show(1, turned(90), SILENCE, "idle", epoch=0, memory=5)
        delivery = buffer.take()
        assert delivery is not None
        assert delivery.start == first
        if first == 5_600:
            np.testing.assert_allclose(angle(delivery.motion), [13], atol=1e-3)  # 12 and half a step


def test_untaken_motion_before_the_cut_stays_and_the_rest_goes() -> None:
    buffer = PlayoutBuffer()
    for chunk in range(2):
        buffer.show(chunk, turned(0), SILENCE, "speech", epoch=0, memory=5)
    buffer.go_back(8_000)
    kept = [buffer.take(), buffer.take()]
    assert [len(delivery.motion.root) for delivery in kept if delivery] == [8, 2]
    assert buffer.take() is None
    assert buffer.taken == 8_000
