import numpy as np

from echoavatar.motion.ik.hand import hand_points
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rigs import bone_map


def places(is_full: bool, bones: dict[str, int]) -> np.ndarray:
    rest = HUMANOID.rest_positions.numpy()
    points = hand_points(HUMANOID, bones, "left", is_full=is_full)
    return np.array([rest[point.joint] + point.offset for point in points])


def test_points_reach_from_the_wrist_to_the_fingertips() -> None:
    """In the rest pose the left hand lies along +X; the middle finger ends 0.184 m from the wrist."""
    found = places(False, bone_map(HUMANOID))
    wrist = HUMANOID.rest_positions[HUMANOID.index("leftHand")].numpy()
    np.testing.assert_allclose(found[0], wrist, atol=1e-6)
    assert 0.03 < found[1, 0] - wrist[0] < 0.06
    assert np.isclose(found[:, 0].max() - wrist[0], 0.090 + 0.044 + 0.027 + 0.023, atol=1e-6)
    assert len(places(True, bone_map(HUMANOID))) == 2 + 14 + 5  # the root of the thumb moves little and is left out


def test_a_hand_without_fingers_still_has_length() -> None:
    bones = {name: joint for name, joint in bone_map(HUMANOID).items() if name.endswith(("Hand", "LowerArm"))}
    found = places(False, bones)
    assert len(found) == 3
    assert 0.15 < found[-1, 0] - found[0, 0] < 0.20
