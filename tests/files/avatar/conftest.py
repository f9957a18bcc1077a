from collections.abc import Callable

import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID

Motion = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="session")
def wave() -> Callable[[int], Motion]:
    """A made-up motion: the right arm waves, the hips drift; quaternions wxyz (t, 52, 4) and root (t, 3)."""

    def make(frames: int) -> Motion:
        t = np.arange(frames) / 30
        rotations = np.zeros((frames, HUMANOID.joints, 4))
        rotations[..., 0] = 1
        for name, angle in (("rightUpperArm", 0.6 * np.sin(2 * t)), ("leftUpperArm", np.full(frames, -1.2))):
            rotations[:, HUMANOID.index(name), 0] = np.cos(angle / 2)
            rotations[:, HUMANOID.index(name), 3] = np.sin(angle / 2)
        return rotations, np.stack([0.05 * np.sin(t), np.full(frames, 0.95), 0 * t], 1)

    return make
