"""Hands that meet, and hands on the body; all of it on other bodies is in tests/files/exports/test_target_rig.py."""

from dataclasses import replace

import numpy as np
import pytest
from tests.files.exports.bodies import offsets_of
from tests.files.exports.moving import TOUCHES, clapping, felt, palms, touching

from echoavatar.motion.ik import body_of_rig
from echoavatar.motion.ik.hand_contact import keep_hands_on_body, keep_hands_together
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
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
    gaps = [np.diff(palms(motion), axis=1)[:, 0] for motion in (source, plain, kept)]
    touching = np.linalg.norm(gaps[0], axis=-1) < 0.1
    assert touching.sum() > 10
    np.testing.assert_allclose(gaps[2][touching], gaps[0][touching], atol=1e-3)
    if factor != 1:
        assert np.abs(gaps[1] - gaps[0])[touching].max() > 0.05  # by rotations alone they do not
    hand = HUMANOID.index("leftHand")
    before, after = (motion.pose().rotations[:, hand] for motion in (plain, kept))
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_hands_that_do_not_meet_are_left_alone() -> None:
    still = np.zeros((5, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    motion = Motion(HUMANOID, still, np.zeros((5, 3), np.float32), 30.0)
    assert keep_hands_together(motion, motion) is motion


LONG = Skeleton(
    HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, offsets_of(body=1.0, legs=1.0, arms=1.4).tolist()))})
)
OURS, THEIRS = body_of_rig(LONG), body_of_rig(HUMANOID)


def put(source: Motion) -> tuple[Motion, Motion]:
    plain = retarget(source, LONG)
    return plain, keep_hands_on_body(source, plain, THEIRS, OURS)


def test_palms_lie_where_they_lay_and_hands_keep_their_orientation() -> None:
    source = touching()
    plain, kept = put(source)
    for touch in TOUCHES:
        places = [felt(motion, body, touch) for motion, body in ((source, THEIRS), (plain, OURS), (kept, OURS))]
        off = [np.linalg.norm((place - places[0][0]) * radii, axis=-1).max() for place, radii in places]
        assert off[2] < 0.02
        assert off[1] > 0.04  # by rotations alone a long arm goes past
    hands = HUMANOID.indices(["leftHand", "rightHand"])
    before, after = (motion.pose().rotations[:, hands] for motion in (plain, kept))
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_arms_that_hang_or_are_far_from_the_body_are_left_alone() -> None:
    hanging = np.zeros((3, HUMANOID.joints, 4), np.float32)
    hanging[..., 0] = 1
    for side, sign in (("left", -1.0), ("right", 1.0)):
        half = sign * np.array([1.5, 1.5, 0.0]) / 2  # beside the hip, beside the hip, aside
        hanging[:, HUMANOID.index(f"{side}UpperArm")] = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], 1)
    plain, kept = put(Motion(HUMANOID, hanging, np.tile([0, 0.95, 0], (3, 1)).astype(np.float32), 30.0))
    np.testing.assert_allclose(palms(kept), palms(plain), atol=1e-6)


def test_a_source_that_lies_at_rest_has_no_known_body() -> None:
    lying = HUMANOID.config.model_copy(update={"offsets": tuple((x, z, y) for x, y, z in HUMANOID.config.offsets)})
    source = touching(1.0)
    moved = retarget(source, LONG)
    assert keep_hands_on_body(replace(source, skeleton=Skeleton(lying)), moved, THEIRS, OURS) is moved


def test_motion_stays_smooth() -> None:
    """No joint turns more between two frames than 1.2 times what the source's fastest does."""
    source = touching()

    def fastest(motion: Motion) -> float:
        alike = np.abs((motion.rotations[1:] * motion.rotations[:-1]).sum(-1)).clip(0, 1)
        return float(2 * np.arccos(alike.astype(np.float64)).max())

    assert fastest(put(source)[1]) < 1.2 * fastest(source)
