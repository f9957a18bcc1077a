import pytest
import torch
from tests.models.fingers.moving import waving, without

from echoavatar.errors import MotionError
from echoavatar.models.fingers.clips import on_our_rig
from echoavatar.models.fingers.finger_retarget import apply_fingers, finger_joints
from echoavatar.models.fingers.hand_poses import FINGERS
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, quaternion_from_matrix


def foreign(motion: Motion) -> Motion:
    """The same motion on a rig whose finger bones are rotated by half a radian at rest."""
    rig = motion.skeleton
    tilt = matrix_from_axis_angle(torch.tensor([0.0, 0.3, 0.4]))
    local, offsets = motion.matrices().clone(), rig.offsets.clone()
    for joint in finger_joints(motion, "left").values():
        is_first = rig.names[rig.parents[joint]] == "leftHand"
        local[:, joint] = local[:, joint] if is_first else tilt.T @ local[:, joint]
        local[:, joint] = local[:, joint] @ tilt
        offsets[joint] = offsets[joint] if is_first else tilt.T @ offsets[joint]
    config = rig.config.model_copy(update={"offsets": tuple(tuple(map(float, row)) for row in offsets)})
    config = config.model_copy(update={"names": tuple(f"r{name}" for name in rig.names), "tips": {}})
    turned = quaternion_from_matrix(local).numpy()
    return Motion(Skeleton(config), turned, motion.root, motion.fps)


def test_fingers_carried_over_and_put_back_are_the_same() -> None:
    """Retargeted fingers applied to the rig they came from change nothing."""
    motion = foreign(waving(30))
    fingers = on_our_rig(motion).matrices()[:, list(FINGERS)]
    back = apply_fingers(motion, fingers, ("left", "right"))
    assert angle_between(back.matrices(), motion.matrices()).max() < 1e-3


def test_only_the_asked_hand_changes_and_missing_bones_are_passed_over() -> None:
    motion = without(waving(30), "Little", "RingDistal")
    fingers = matrix_from_axis_angle(0.3 * torch.randn(30, 30, 3))
    made = apply_fingers(motion, fingers, ("right",))
    changed = {
        name
        for joint, name in enumerate(motion.skeleton.names)
        if (made.rotations[:, joint] != motion.rotations[:, joint]).any()
    }
    assert changed == set(finger_joints(motion, "right"))
    assert len(changed) == 11


def test_an_unknown_rig_is_refused() -> None:
    config = waving(1).skeleton.config.model_copy(update={"vrm": {}, "names": tuple(f"j{i}" for i in range(52))})
    motion = Motion(Skeleton(config), waving(1).rotations, waving(1).root, 30.0)
    with pytest.raises(MotionError, match="is not known"):
        finger_joints(motion, "left")
