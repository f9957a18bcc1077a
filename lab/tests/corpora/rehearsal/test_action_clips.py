import numpy as np
import pytest

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip


@pytest.mark.parametrize("name", ["wave", "bow", "clap", "disagree"])
def test_a_clip_begins_and_ends_at_ease_and_moves_no_joint_too_fast(name: str) -> None:
    motion = clip(SCRIPTS[name])
    turns = motion.rotations
    np.testing.assert_allclose(turns[0], turns[-1], atol=1e-5)
    dots = np.abs((turns[1:] * turns[:-1]).sum(-1)).clip(0, 1)
    assert 20 < np.degrees(2 * np.arccos(dots)).max() * 30 < 800


def test_left_and_right_are_mirror_images() -> None:
    left, right = clip(SCRIPTS["raise_left_hand"]), clip(SCRIPTS["raise_right_hand"])
    own, other = (
        motion.rotations[:, HUMANOID.index(f"{side}UpperArm")] for motion, side in ((left, "left"), (right, "right"))
    )
    np.testing.assert_allclose(own * [1, 1, -1, -1], other, atol=1e-4)
