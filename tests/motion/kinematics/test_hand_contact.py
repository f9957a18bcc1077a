"""Hands that meet; the whole of it on other bodies is in tests/files/exports/test_rig.py."""

import numpy as np
import pytest
from tests.files.exports.moving import clapping

from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.hand_contact import keep_hands_together, palms
from echoavatar.motion.kinematics.retarget import retarget


def wide(factor: float) -> Skeleton:
    """Our rig with other forearms, but none of it in the rest of the body."""
    offsets = [
        tuple(factor * x for x in offset) if name.endswith(("LowerArm", "Hand")) else offset
        for name, offset in zip(HUMANOID.names, HUMANOID.config.offsets, strict=True)
    ]
    return Skeleton(HUMANOID.config.model_copy(update={"offsets": tuple(offsets)}))


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.3])
def test_palms_touch_as_before_and_hands_keep_their_orientation(factor: float) -> None:
    source = clapping(2.0)
    plain = retarget(source, wide(factor))
    kept = keep_hands_together(source, plain)
    gaps = [np.diff(palms(motion).numpy(), axis=1)[:, 0] for motion in (source, plain, kept)]
    touching = np.linalg.norm(gaps[0], axis=-1) < 0.1
    assert touching.sum() > 10
    np.testing.assert_allclose(gaps[2][touching], gaps[0][touching], atol=1e-3)
    if factor != 1:
        assert np.abs(gaps[1] - gaps[0])[touching].max() > 0.05  # by rotations alone they do not
    hand = HUMANOID.index("leftHand")
    before, after = (motion.pose().rotations[:, hand].numpy() for motion in (plain, kept))
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_hands_that_do_not_meet_are_left_alone() -> None:
    still = np.zeros((5, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    motion = Motion(HUMANOID, still, np.zeros((5, 3), np.float32), 30.0)
    assert keep_hands_together(motion, motion) is motion
