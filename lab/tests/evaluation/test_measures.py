import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle
from echoavatar_lab.evaluation.measures import (
    Track,
    border_ratio,
    border_speed_ratio,
    clip_statistics,
    hand_speed_m_s,
    measure_clip,
    settled,
    stretches,
    track,
)
from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS


def clip(frames: int = 90, *, turn_per_frame: float = 0.0) -> Track:
    angles = np.zeros((frames, HUMANOID.joints, 3), np.float32)
    angles[:, HUMANOID.index("leftUpperArm"), 2] = np.arange(frames) * turn_per_frame
    root = np.tile(HUMANOID.rest_positions[0], (frames, 1))
    return track(Motion(HUMANOID, quaternion_from_axis_angle(angles), root, 30.0), np.zeros(frames, np.uint8))


def test_angular_speed_is_in_degrees_per_second() -> None:
    """0.01 rad a frame at 30 fps is 17.19 degrees a second, in the turned joint only."""
    speed = clip(turn_per_frame=0.01).angular_speed
    arm = HUMANOID.index("leftUpperArm")
    np.testing.assert_allclose(speed[:, arm], np.degrees(0.3), rtol=1e-3)
    assert speed[:, [j for j in range(52) if j != arm]].max() < 0.2


def test_a_still_body_has_no_energy_and_a_moving_hand_does() -> None:
    hands = [HUMANOID.index("leftHand")]
    assert hand_speed_m_s(clip(), hands).max() == pytest.approx(0, abs=1e-5)
    speed = hand_speed_m_s(clip(turn_per_frame=0.01), hands)
    np.testing.assert_allclose(speed, (0.265 + 0.245) * 0.3, rtol=1e-2)


def test_only_long_silence_counts_and_its_first_second_does_not() -> None:
    domain = np.array([1] * 30 + [0] * 59 + [1] * 10 + [0] * 90)
    quiet = settled(domain)
    assert not quiet[:129].any()
    assert quiet[129:].all()


def test_a_jump_at_chunk_borders_is_seen() -> None:
    frames = np.arange(160)
    smooth = np.zeros((160, 1, 3))
    smooth[:, 0, 0] = np.sin(frames / 9.7)
    jumpy = smooth.copy()
    jumpy[:, 0, 1] = (frames // 8) % 2 * 0.2
    domain = np.zeros(160, np.uint8)
    still = np.zeros((159, 1))
    assert border_ratio([Track(smooth, still, domain)]) == pytest.approx(1, abs=0.1)
    assert border_ratio([Track(jumpy, still, domain)]) > 2
    assert border_speed_ratio([Track(smooth, still, domain)]) == pytest.approx(1, abs=0.1)
    assert border_speed_ratio([Track(jumpy, still, domain)]) > 1.5


def test_floor_depth_is_measured_from_the_standing_height() -> None:
    still = np.zeros((30, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    root = np.tile(HUMANOID.rest_positions[0], (30, 1)).astype(np.float32)
    assert measure_clip(Motion(HUMANOID, still, root, 30.0)).numbers["floor_depth"] == pytest.approx(0, abs=1e-3)
    root[:, 1] -= 0.03
    assert measure_clip(Motion(HUMANOID, still, root, 30.0)).numbers["floor_depth"] == pytest.approx(3, abs=1e-3)


def test_a_short_clip_has_no_novelty() -> None:
    assert np.isnan(clip_statistics(swaying(60))[list(STATISTICS).index("novelty")])


def test_a_stretch_bridges_pauses_but_no_other_sound() -> None:
    """Speech, 1 s of silence, speech; 3 s of silence; speech, music, speech: only the first lasts 10 s."""
    domain = np.repeat([1, 0, 1, 0, 1, 2, 1], [200, 30, 80, 90, 200, 310, 200]).astype(np.uint8)
    assert stretches(domain, 1) == [slice(0, 310)]
    assert stretches(domain, 2) == [slice(600, 910)]
    assert stretches(domain, 1, 5.0) == [slice(0, 310), slice(400, 600), slice(910, 1110)]
    assert stretches(np.zeros(400, np.uint8), 1) == []
