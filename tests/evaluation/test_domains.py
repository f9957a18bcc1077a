"""Who dances is told by the legs, who gestures by the arms."""

import numpy as np

from echoavatar.evaluation.alive import Take
from echoavatar.evaluation.domains import as_text, danced, gestured, shares
from echoavatar.motion.kinematics import HUMANOID, Motion


def moving(joint: str, degrees_s: float, frames: int = 150) -> Motion:
    """A body of which one joint rotates to and fro, half a second each way."""
    rotations = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    angle = np.radians(degrees_s) * np.abs((np.arange(frames) / 30 + 0.5) % 1 - 0.5)
    rotations[:, HUMANOID.index(joint), :2] = np.stack([np.cos(angle / 2), np.sin(angle / 2)], axis=-1)
    return Motion(HUMANOID, rotations, np.zeros((frames, 3), np.float32), 30.0)


def test_one_joint_of_four_counts_a_quarter() -> None:
    assert danced(moving("leftUpperLeg", 64)).all()
    assert not danced(moving("leftUpperLeg", 52)).any()
    assert not gestured(moving("leftUpperLeg", 64)).any()
    assert gestured(moving("rightLowerArm", 64)).all()
    assert not danced(moving("rightLowerArm", 64)).any()


def test_a_body_at_rest_does_neither() -> None:
    still = moving("leftUpperLeg", 0)
    assert not (danced(still) | gestured(still)).any()


def test_shares_by_class_and_kind() -> None:
    takes = [
        Take("a", "speech", "English, male", moving("leftUpperLeg", 90, 100)),
        Take("b", "speech", "English, female", moving("leftUpperArm", 90, 300)),
    ]
    found = {row.group: row for row in shares(takes)}
    assert (found["all"].danced, found["all"].gestured, found["all"].takes) == (0.25, 0.75, 2)
    assert (found["English, male"].danced, found["English, female"].danced) == (1, 0)
    assert "| speech | all | 2 | 13 | 25 | 75 |" in as_text(shares(takes))
