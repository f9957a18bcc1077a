from dataclasses import replace

import numpy as np
import pytest
import torch
from lab.tests.datasets.samples import gesture

from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between, quaternion_from_axis_angle, quaternion_multiply
from echoavatar_lab.datasets.hand_contact import arm_length, keep_hand_contact

HANDS = HUMANOID.indices(("leftHand", "rightHand"))


def folding(seconds: float = 4.0) -> Motion:
    """Hanging upper arms rotate inwards and back, so that bent forearms meet in front of the belly and part."""
    motion = gesture(seconds)
    rotations = motion.rotations.copy()
    inward = 0.9 * np.sin(np.pi * np.arange(motion.frames) / motion.frames) ** 2
    none = np.zeros_like(inward)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        down = quaternion_from_axis_angle(torch.from_numpy(np.stack([none, none, none - sign * 1.35], 1)))
        turn = quaternion_from_axis_angle(torch.from_numpy(np.stack([inward, none, none], 1)))
        bend = quaternion_from_axis_angle(torch.from_numpy(np.stack([none, none - sign * 1.5, none], 1)))
        rotations[:, HUMANOID.index(f"{side}UpperArm")] = quaternion_multiply(down, turn).numpy()
        rotations[:, HUMANOID.index(f"{side}LowerArm")] = bend.numpy()
    return replace(motion, rotations=rotations)


def narrow(motion: Motion, by: float = 0.04) -> Motion:
    """The same rotations on a body whose shoulders are narrower by `by` metres on each side."""
    offsets = list(motion.skeleton.config.offsets)
    for side, sign in (("left", 1), ("right", -1)):
        x, y, z = offsets[HUMANOID.index(f"{side}UpperArm")]
        offsets[HUMANOID.index(f"{side}UpperArm")] = (x - sign * by, y, z)
    return replace(motion, skeleton=Skeleton(motion.skeleton.config.model_copy(update={"offsets": tuple(offsets)})))


def apart(motion: Motion) -> torch.Tensor:
    places = motion.pose().positions[:, HANDS]
    return (places[:, 0] - places[:, 1]).norm(dim=-1)


def test_hands_that_meet_come_as_near_as_they_were():
    source = narrow(folding())
    before = retarget(source)
    near = apart(source) < 0.35 * arm_length(source)
    assert bool(near.any()), "the gesture must bring the hands together"
    assert float((apart(before) - apart(source))[near].min()) > 0.05
    after = keep_hand_contact(before, source)
    np.testing.assert_allclose(apart(after)[near], apart(source)[near], atol=5e-3)


def test_hands_keep_their_orientation_and_the_rest_of_the_body_its_pose():
    source = narrow(folding())
    before = retarget(source)
    after = keep_hand_contact(before, source)
    hands = angle_between(before.pose().rotations[:, HANDS], after.pose().rotations[:, HANDS])
    assert float(torch.rad2deg(hands).max()) < 0.1
    arms = HUMANOID.indices([f"{s}{b}" for s in ("left", "right") for b in ("UpperArm", "LowerArm", "Hand")])
    others = [j for j in range(HUMANOID.joints) if j not in arms]
    assert np.array_equal(before.rotations[:, others], after.rotations[:, others])


def test_nothing_jumps_on_the_way():
    """The hands are corrected by up to 4 cm; a jump would be an acceleration of 4 cm per frame squared."""
    source = narrow(folding())
    after = keep_hand_contact(retarget(source), source)
    assert float(after.pose().positions[:, HANDS].diff(n=2, dim=0).norm(dim=-1).max()) < 1e-3


def test_hands_that_stay_apart_are_left_alone():
    hanging = gesture(1.0)
    rotations = hanging.rotations.copy()
    rotations[:] = [1, 0, 0, 0]
    still = replace(hanging, rotations=rotations)  # a T-pose
    assert keep_hand_contact(still, narrow(still)) is still


def test_arm_length_is_upper_arm_and_forearm():
    assert arm_length(gesture(0.1)) == pytest.approx(0.265 + 0.245)
