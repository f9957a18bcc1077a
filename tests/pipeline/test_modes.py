import numpy as np

from echoavatar.kinematics import HUMANOID, Motion
from echoavatar.kinematics.rotations import quaternion_from_axis_angle
from echoavatar.pipeline.modes import in_place, upper_body


def moving() -> Motion:
    import torch

    torch.manual_seed(0)
    turns = quaternion_from_axis_angle(torch.randn(10, 52, 3) * 0.3).numpy()
    root = np.cumsum(np.full((10, 3), 0.01, np.float32), 0) + HUMANOID.rest_positions[0].numpy()
    return Motion(HUMANOID, turns, root.astype(np.float32), 30.0)


def test_in_place_keeps_height_and_pose_only() -> None:
    motion = moving()
    still = in_place(motion)
    assert np.ptp(still.root[:, [0, 2]], axis=0).max() == 0
    assert np.array_equal(still.root[:, 1], motion.root[:, 1])
    assert np.array_equal(still.rotations, motion.rotations)


def test_upper_body_stands_on_the_floor_and_keeps_arms_and_fingers() -> None:
    motion = moving()
    still = upper_body(motion)
    feet = still.pose().positions[:, list(HUMANOID.config.feet)].numpy()
    assert np.ptp(feet, axis=0).max() < 1e-6
    kept = [*HUMANOID.config.parts["upper"], *HUMANOID.config.parts["hands"]]
    assert np.array_equal(still.rotations[:, kept], motion.rotations[:, kept])
