"""Hands that come together in the source come together on our rig as well.

Retargeting keeps the directions of bones. A rig with broader shoulders or other arms then parts hands that clap, fold
or rub. Where the source's wrists are near each other, ours are brought to the same vector between them, in arm
lengths, by half a step each; elbows give way, the hands keep their orientation. The nearer, the more: nothing
changes where the hands are apart, and nothing jumps.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from ..kinematics import Motion
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import quaternion_from_matrix
from ..kinematics.two_bone import reach

NEAR_ARMS, FAR_ARMS = (
    0.35,
    0.8,
)  # wrists this near are matched in full, this far are left alone; in arm lengths


class _Arm(NamedTuple):
    shoulder: int
    elbow: int
    hand: int
    bends: float  # about +Y of our forearm, or -Y


def keep_hand_contact(motion: Motion, source: Motion) -> Motion:
    """The motion on our rig with hands that meet where the source's do.

    Args:
        motion: on our rig, retargeted from `source`.
        source: the same frames on the recording's own rig.
    """
    wanted = _between(source) / arm_length(source) * arm_length(motion)
    bones, pose = bone_map(motion.skeleton), motion.pose()
    places, turns = pose.positions.double(), pose.rotations.double()
    weight = _weight(wanted.norm(dim=-1) / arm_length(motion))
    if float(weight.max()) == 0:
        return motion
    now = places[:, bones["leftHand"]] - places[:, bones["rightHand"]]
    step = (wanted - now) * weight[:, None] / 2
    local = motion.matrices().double().clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = _Arm(bones[f"{side}UpperArm"], bones[f"{side}LowerArm"], bones[f"{side}Hand"], -sign)
        _bring(local, arm, motion.skeleton.parents, (places, turns), places[:, arm.hand] + sign * step)
    is_moved = weight > 0
    rotations = motion.rotations.copy()
    for side in ("left", "right"):
        for bone in ("UpperArm", "LowerArm", "Hand"):
            joint = bones[side + bone]
            made = quaternion_from_matrix(local[:, joint]).float()
            rotations[is_moved.numpy(), joint] = made[is_moved].numpy()
    return replace(motion, rotations=rotations)


def _bring(
    local: Tensor,
    arm: _Arm,
    parents: tuple[int, ...],
    world: tuple[Tensor, Tensor],
    target: Float[Tensor, "t 3"],
) -> None:
    """Write the arm's rotations that put the wrist at its target; the hand stays turned as it is."""
    places, turns = world
    first, second = reach(
        hip=places[:, arm.shoulder],
        knee=places[:, arm.elbow],
        ankle=places[:, arm.hand],
        hinge=arm.bends * turns[:, arm.elbow, :, 1],
        target=target,
    )
    upper, fore = first @ turns[:, arm.shoulder], second @ turns[:, arm.elbow]
    local[:, arm.shoulder] = turns[:, parents[arm.shoulder]].transpose(-1, -2) @ upper
    local[:, arm.elbow] = upper.transpose(-1, -2) @ fore
    local[:, arm.hand] = fore.transpose(-1, -2) @ turns[:, arm.hand]


def _weight(apart: Float[Tensor, " t"]) -> Float[Tensor, " t"]:
    """1 for hands together, 0 for hands apart, smooth in between."""
    share = ((FAR_ARMS - apart) / (FAR_ARMS - NEAR_ARMS)).clamp(0, 1)
    return share.pow(3) * (10 - 15 * share + 6 * share.square())


def _between(motion: Motion) -> Float[Tensor, "t 3"]:
    """From the right wrist to the left, metres, world axes."""
    bones, places = bone_map(motion.skeleton), motion.pose().positions.double()
    return places[:, bones["leftHand"]] - places[:, bones["rightHand"]]


def arm_length(motion: Motion) -> float:
    """Upper arm plus forearm, mean of both sides, metres."""
    bones: Mapping[str, int] = bone_map(motion.skeleton)
    joints = [bones[f"{side}{bone}"] for side in ("left", "right") for bone in ("LowerArm", "Hand")]
    return float(motion.skeleton.offsets[joints].norm(dim=-1).sum() / 2)
