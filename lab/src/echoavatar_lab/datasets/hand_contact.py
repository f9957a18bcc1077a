"""Keeps hands together that are together in the source.

Retargeting keeps bone directions, so on a rig with broader shoulders clapping or folded hands come apart. Where the
source's wrists are close, arm IK moves both of ours by half the way to the same vector between them, in arm lengths;
hands keep their orientation. The correction fades out with the distance between the hands, so motion does not jump.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.motion.kinematics.two_bone import reach

NEAR_ARMS, FAR_ARMS = (
    0.35,
    0.8,
)  # arm lengths between the wrists: below the first full correction, above the second none


class _Arm(NamedTuple):
    shoulder: int
    elbow: int
    hand: int
    hinge_sign: float  # the elbow bends about +Y or -Y of the forearm


def keep_hand_contact(motion: Motion, source: Motion) -> Motion:
    """The motion with hands as close together as in the source, where they are close there.

    Args:
        motion: on our rig, retargeted from `source`.
        source: the same frames on the recording's own rig.
    """
    wanted = _between(source) / arm_length(source) * arm_length(motion)
    bones, pose = bone_map(motion.skeleton), motion.pose()
    places, world_rotations = pose.positions.double(), pose.rotations.double()
    weight = _weight(wanted.norm(dim=-1) / arm_length(motion))
    if float(weight.max()) == 0:
        return motion
    now = places[:, bones["leftHand"]] - places[:, bones["rightHand"]]
    step = (wanted - now) * weight[:, None] / 2
    local = motion.matrices().double().clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = _Arm(bones[f"{side}UpperArm"], bones[f"{side}LowerArm"], bones[f"{side}Hand"], -sign)
        _bring(local, arm, motion.skeleton.parents, (places, world_rotations), places[:, arm.hand] + sign * step)
    is_moved = weight > 0
    rotations = motion.rotations.copy()
    for side in ("left", "right"):
        for bone in ("UpperArm", "LowerArm", "Hand"):
            joint = bones[side + bone]
            made = quaternion_from_matrix(local[:, joint]).float()
            rotations[is_moved.numpy(), joint] = made[is_moved].numpy()
    return replace(motion, rotations=rotations)


def _bring(
    local: Tensor, arm: _Arm, parents: tuple[int, ...], world: tuple[Tensor, Tensor], target: Float[Tensor, "t 3"]
) -> None:
    """Write the arm's rotations that put the wrist at its target; the hand keeps its world orientation."""
    places, world_rotations = world
    first, second = reach(
        hip=places[:, arm.shoulder],
        knee=places[:, arm.elbow],
        ankle=places[:, arm.hand],
        hinge=arm.hinge_sign * world_rotations[:, arm.elbow, :, 1],
        target=target,
    )
    upper, fore = first @ world_rotations[:, arm.shoulder], second @ world_rotations[:, arm.elbow]
    local[:, arm.shoulder] = world_rotations[:, parents[arm.shoulder]].transpose(-1, -2) @ upper
    local[:, arm.elbow] = upper.transpose(-1, -2) @ fore
    local[:, arm.hand] = fore.transpose(-1, -2) @ world_rotations[:, arm.hand]


def _weight(apart: Float[Tensor, " t"]) -> Float[Tensor, " t"]:
    """1 for hands together, 0 for hands apart, smooth in between."""
    share = ((FAR_ARMS - apart) / (FAR_ARMS - NEAR_ARMS)).clamp(0, 1)
    return share.pow(3) * (10 - 15 * share + 6 * share.square())


def _between(motion: Motion) -> Float[Tensor, "t 3"]:
    """Vector from the right wrist to the left, metres, world axes."""
    bones, places = bone_map(motion.skeleton), motion.pose().positions.double()
    return places[:, bones["leftHand"]] - places[:, bones["rightHand"]]


def arm_length(motion: Motion) -> float:
    """Length of upper arm plus forearm, mean of both sides, metres."""
    bones: Mapping[str, int] = bone_map(motion.skeleton)
    joints = [bones[f"{side}{bone}"] for side in ("left", "right") for bone in ("LowerArm", "Hand")]
    return float(motion.skeleton.offsets[joints].norm(dim=-1).sum() / 2)
