"""What a talker's hips, shoulders and head add to trunk and arms."""

import numpy as np
import pytest
from tests.motion.stages.poses import everyone

from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_axis_angle
from echoavatar.motion.stages.pose import Pose
from echoavatar.motion.stages.stillness import Stillness

FRAMES = 120
X, Y, Z = np.eye(3)


def turned(**turns: tuple[np.ndarray, object]) -> np.ndarray:
    """(1, t, j, 4): each joint turned about an axis by radians, one for all frames or one a frame."""
    vectors = np.zeros((1, FRAMES, HUMANOID.joints, 3), np.float32)
    for joint, (axis, by) in turns.items():
        vectors[0, :, HUMANOID.index(joint)] = np.broadcast_to(by, FRAMES)[:, None] * axis
    return quaternion_from_axis_angle(vectors)


def shown(rotations: np.ndarray, *, talks: float = 1.0, travel: float = 0.0, stands: bool = False) -> np.ndarray:
    """What is shown of whole-sized gestures, in chunks of 8 frames: rotations (t, j, 4)."""
    stage, made = Stillness(HUMANOID), rotations.copy()
    state = stage.init_state(1)
    for at in range(0, FRAMES, 8):
        part = np.ascontiguousarray(made[:, at : at + 8])
        root = np.full((*part.shape[:2], 3), (0, 0.9, travel / 30), np.float32)
        stage.step(Pose(part, root, 30.0), state, everyone(1), np.float32([[1, 1, talks]]), np.array([stands]))
        made[:, at : at + 8] = part
    return made[0]


def world(rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (t, j, 3, 3) and places (t, j, 3), metres, of hips at the origin."""
    return forward_kinematics(HUMANOID, matrix_from_quaternion(rotations), np.zeros((len(rotations), 3)))


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    """The angle between two rotations."""
    return float(np.degrees(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))))


@pytest.mark.parametrize(("axis", "share"), [(Y, 0.4), (X, 0.2)])
def test_a_talkers_hips_turn_with_the_trunk_whose_chest_and_thighs_keep_their_directions(
    axis: np.ndarray, share: float
) -> None:
    """They lean with it too, by less."""
    sway = np.radians(15) * np.sin(2 * np.arange(FRAMES) / 30)
    hips, (talks, dances) = HUMANOID.index("hips"), (shown(turned(spine=(axis, sway)), talks=talks) for talks in (1, 0))
    ours, trunk = (
        2 * np.arctan2(made[60:, joint, 1:] @ axis, made[60:, joint, 0])
        for made, joint in ((talks, hips), (dances, HUMANOID.index("spine")))
    )
    assert np.ptp(ours) / np.ptp(trunk) == pytest.approx(share, abs=0.05)
    assert not dances[:, hips, 1:].any()
    for joint, most in (("chest", 0.1), ("head", 0.1), ("leftUpperLeg", 3.0)):  # a talker's legs stand further out
        pair = (world(one)[0][:, HUMANOID.index(joint)] for one in (talks, dances))
        assert max(degrees(a, b) for a, b in zip(*pair, strict=True)) < most


@pytest.mark.parametrize("options", [{"travel": 0.6}, {"stands": True}])
def test_the_hips_of_who_travels_or_moves_the_upper_body_alone_stay(options: dict) -> None:
    made = shown(turned(spine=(Y, 0.3)), **options)
    np.testing.assert_allclose(made[60:, HUMANOID.index("hips"), 1:], 0, atol=1e-6)


@pytest.mark.parametrize(("side", "down"), [("left", -Z), ("right", Z)])
def test_a_talkers_shoulder_rises_with_its_arm_which_keeps_its_direction(side: str, down: np.ndarray) -> None:
    """By nothing beside a hanging arm, by 2 to 6 cm where the arm is level."""
    arm, lower = (HUMANOID.index(f"{side}{bone}") for bone in ("UpperArm", "LowerArm"))
    for lowered, least, most in ((np.radians(72), -0.004, 0.004), (0, 0.02, 0.06)):
        pose = turned(**{f"{side}UpperArm": (down, lowered)})
        (was, before), (now, after) = world(shown(pose, talks=0.0)), world(shown(pose))
        assert least < (after - before)[-1, arm, 1] < most
        np.testing.assert_allclose((after[:, lower] - after[:, arm]), before[:, lower] - before[:, arm], atol=1e-4)
        assert degrees(was[-1, lower], now[-1, lower]) < 0.1


def test_a_shoulder_comes_forward_with_an_arm_that_points_to_the_front() -> None:
    pose = turned(leftUpperArm=(-Y, np.radians(80)))
    before, after = (world(shown(pose, talks=talks))[1][-1, HUMANOID.index("leftUpperArm")] for talks in (0.0, 1.0))
    assert 0.01 < (after - before)[2] < 0.04
