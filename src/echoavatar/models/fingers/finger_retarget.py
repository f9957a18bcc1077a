"""Inverse retargeting of fingers: from our rig to the hands of any other rig.

Retargeting gives our bone the world rotation of its counterpart times a constant A (`kinematics.alignment`). Here the
counterpart gets our rotation times the inverse of A, relative to its own hand. Joints that our rig lacks, such as
metacarpals, keep their rotations, and so does the body.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID, Motion, forward_kinematics
from echoavatar.motion.kinematics.alignment import align
from echoavatar.motion.kinematics.rigs import bone_map, finger_bones
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix

from .hand_poses import FINGERS


def finger_joints(motion: Motion, side: str) -> dict[str, int]:
    """Map VRM names to joints, for the finger bones of one hand that the rig has.

    Raises:
        MotionError: the rig's joint names are unknown.
    """
    bones = bone_map(motion.skeleton)
    named = (bone for digit in finger_bones(side).values() for bone in digit)
    return {bone: bones[bone] for bone in named if bone in bones}


def apply_fingers(motion: Motion, fingers: Float[Tensor, "t 30 3 3"], sides: Sequence[str]) -> Motion:
    """The motion with these fingers (parent-relative rotations of our rig) on the hands of `sides`."""
    bones, ours = bone_map(motion.skeleton), bone_map(HUMANOID)
    local = motion.matrices().double()
    pose = forward_kinematics(motion.skeleton, local, torch.from_numpy(motion.root).double())
    alignments = align(motion.skeleton, pose, bones, HUMANOID, ours)
    rotations = motion.rotations.copy()
    for side in sides:
        wanted = _from_the_hand(fingers.double(), alignments, side)
        found = {joint: wanted[bone] for bone, joint in finger_joints(motion, side).items()}
        for joint, rotation in _localised(motion, local, bones[f"{side}Hand"], found).items():
            rotations[:, joint] = quaternion_from_matrix(rotation).numpy().astype(np.float32)
    return replace(motion, rotations=rotations)


def _from_the_hand(fingers: Tensor, alignments: dict[str, Tensor], side: str) -> dict[str, Tensor]:
    """Rotation of each finger bone of the other rig, relative to its hand."""
    found: dict[str, Tensor] = {}
    full = {HUMANOID.index(f"{side}Hand"): alignments[f"{side}Hand"]}
    for row, joint in enumerate(FINGERS):
        name = HUMANOID.names[joint]
        if not name.startswith(side):
            continue
        full[joint] = full[HUMANOID.parents[joint]] @ fingers[:, row]
        if name in alignments:
            found[name] = full[joint] @ alignments[name].T
    return found


def _localised(motion: Motion, local: Tensor, hand: int, wanted: dict[int, Tensor]) -> dict[int, Tensor]:
    """Parent-relative rotations of the wanted joints, from the hand downwards."""
    full = {hand: torch.eye(3).double().expand(motion.frames, 3, 3)}
    found: dict[int, Tensor] = {}
    for joint in range(hand + 1, motion.skeleton.joints):
        above = full.get(motion.skeleton.parents[joint])
        if above is None:
            continue
        if joint in wanted:
            full[joint] = wanted[joint]
            found[joint] = above.transpose(-1, -2) @ wanted[joint]
        else:
            full[joint] = above @ local[:, joint]
    return found
