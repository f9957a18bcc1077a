"""Motions made by formula, and the recorded ones beside the repository where there are any."""

from pathlib import Path

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_axis_angle

DATA = Path(__file__).parents[3] / "../shared/data"


def recorded(name: str) -> Path:
    """A file of the reference data; the test is skipped where there is none."""
    path = DATA / name
    if not path.exists():
        pytest.skip("needs ../shared/data, which only a checkout with the authors' recordings has")
    return path


def swaying(frames: int = 60, fps: float = 30.0, size: float = 0.3, skeleton: Skeleton = HUMANOID) -> Motion:
    """Every joint turns to and fro on its own axis; the root drifts."""
    t = np.arange(frames)[:, None, None] / fps
    joint = np.arange(skeleton.joints)[None, :, None]
    axis = np.sin(joint * np.array([1.0, 2.0, 3.0]) + 1)
    turns = quaternion_from_axis_angle(size * np.sin(2 * np.pi * (0.5 * t + 0.1 * joint)) * axis)
    root = skeleton.offsets[0] + np.concatenate([0.1 * t[:, 0], 0.01 * np.sin(t[:, 0]), 0.2 * t[:, 0]], 1)
    return Motion(skeleton, turns.astype(np.float32), root.astype(np.float32), fps)


def matrix_from_euler(angles: np.ndarray, order: str) -> np.ndarray:
    """Intrinsic Euler angles, in the order of the letters: "zyx" gives Rz(a0) Ry(a1) Rx(a2)."""
    axes = [np.eye(3)["xyz".index(letter)] for letter in order]
    first, second, third = (matrix_from_axis_angle(angles[..., i, None] * axis) for i, axis in enumerate(axes))
    return first @ second @ third


def chain(*offsets: tuple[float, float, float]) -> Skeleton:
    """Joints in a row."""
    return Skeleton(
        SkeletonConfig(
            names=tuple(f"joint{i}" for i in range(len(offsets))),
            parents=tuple(range(-1, len(offsets) - 1)),
            offsets=offsets,
        )
    )
