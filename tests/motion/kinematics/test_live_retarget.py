"""A stream of frames on another rig: against the retargeting of whole clips, and against plain expectations."""

import numpy as np
import pytest
import torch

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.live_retarget import LiveRetarget
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle, quaternion_from_matrix


def taller() -> Skeleton:
    """Our rig, a quarter larger, its arms hanging half-way down in the rest pose."""
    config = HUMANOID.config
    offsets = HUMANOID.offsets * 1.25
    turn = matrix_from_axis_angle(torch.tensor([[0.0, 0.0, -0.7], [0.0, 0.0, 0.7]]))
    for joint, name in enumerate(config.names):
        for side, own in zip(("left", "right"), turn, strict=True):
            is_arm = name.startswith(side) and any(part in name for part in ("LowerArm", "Hand", "Thumb", "Index"))
            is_arm |= name.startswith(side) and any(part in name for part in ("Middle", "Ring", "Little"))
            if is_arm:
                offsets[joint] = own @ offsets[joint]
    return Skeleton(config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist()))}))


def test_a_rig_on_itself_changes_nothing() -> None:
    turns = matrix_from_axis_angle(0.3 * torch.randn(5, 52, 3, generator=torch.Generator().manual_seed(0)))
    moved = LiveRetarget(HUMANOID)(turns)
    feet = [HUMANOID.index(name) for name in ("leftFoot", "leftToes", "rightFoot", "rightToes")]
    others = [joint for joint in range(52) if joint not in feet]
    torch.testing.assert_close(moved.rotations[:, others], turns[:, others], atol=1e-5, rtol=0)
    assert angle_between(moved.rotations[:, feet], turns[:, feet]).max() < 1e-3
    torch.testing.assert_close(moved.offset, torch.zeros(5, 3), atol=1e-5, rtol=0)


def test_bones_point_where_the_sources_do_and_the_rest_pose_stands_on_the_floor() -> None:
    source, live = taller(), LiveRetarget(taller())
    turns = matrix_from_axis_angle(0.3 * torch.randn(6, 52, 3, generator=torch.Generator().manual_seed(1)))
    turns[0] = torch.eye(3)
    moved = live(turns)
    root = source.offsets[:1].expand(6, 3)
    theirs = forward_kinematics(source, turns, root)
    ours = forward_kinematics(HUMANOID, moved.rotations, live.scale * root + moved.offset)
    bones = [("leftUpperArm", "leftLowerArm"), ("rightLowerArm", "rightHand"), ("leftUpperLeg", "leftLowerLeg")]
    for upper, lower in bones:
        a, b = HUMANOID.index(upper), HUMANOID.index(lower)
        one, other = (pose.positions[:, b] - pose.positions[:, a] for pose in (theirs, ours))
        assert torch.nn.functional.cosine_similarity(one, other).min() > 0.9999
    standing = ours.positions[0, [HUMANOID.index("leftFoot"), HUMANOID.index("rightFoot")], 1]
    torch.testing.assert_close(standing, torch.full((2,), HUMANOID.rest_positions[HUMANOID.index("leftFoot"), 1]))
    assert live.scale == pytest.approx(0.8)


def test_a_clip_retargeted_at_once_agrees(swaying: tuple[np.ndarray, np.ndarray]) -> None:
    """Feet aside, whose rest `retarget` takes from the clip; frames one by one are those of the whole."""
    rotations, _ = swaying
    source = taller()
    turns = torch.from_numpy(rotations[:20])
    clip = Motion(source, quaternion_from_matrix(turns).numpy(), np.tile(source.offsets[0].numpy(), (20, 1)), 30.0)
    whole = retarget(clip, has_footing=False).matrices()
    live = LiveRetarget(source)
    moved = torch.cat([live(frame[None]).rotations for frame in turns])
    assert angle_between(moved, whole).max() < 2e-3


def test_a_rig_that_lies_down_is_refused() -> None:
    lying = HUMANOID.offsets[:, [0, 2, 1]] * torch.tensor([1.0, 1.0, -1.0])
    config = HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, lying.tolist()))})
    with pytest.raises(MotionError, match="stand upright"):
        LiveRetarget(Skeleton(config))
