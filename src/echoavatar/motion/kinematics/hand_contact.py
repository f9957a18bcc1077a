"""Keep touching hands together on a body of other proportions: the last step of retargeting a clip.

If only rotations are retargeted, a clap makes long arms pass through each other, and short arms never meet. Where the
source's palms are near each other, the target's palms get the same offset from each other, scaled by the size of the
hands, about their own midpoint. Both arms bend by closed-form IK, and the hands keep their orientation.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from .easing import falloff
from .forward import Pose, forward_kinematics
from .motion import Motion
from .rigs import bone_map
from .rotations import quaternion_from_matrix
from .skeleton import Skeleton
from .two_bone import reach

NEAR, FAR = 1.3, 3.5  # hand lengths between the palms: full effect up to NEAR, none from FAR on
FOREARM = 0.37  # length of a hand without knuckles, as a share of the forearm
PALM = 0.8  # where the palm is on the way from the wrist to the knuckles
_STRAIGHT = 0.15  # weight of the rest pose's hinge, which decides where the elbow is nearly straight


class Arm(NamedTuple):
    """The joints of an arm, its palm, and how its elbow bends."""

    above: tuple[int, int, int]  # parents of upper arm, lower arm and hand
    upper: int
    lower: int
    hand: int
    palm: Float[Tensor, "3"]  # from the wrist, in the hand's frame
    length: float  # from wrist to knuckles
    hinge: Float[Tensor, "3"]  # axis about which the elbow flexes, at rest


def keep_hands_together(source: Motion, moved: Motion) -> Motion:
    """`moved` (`source` on another rig) with its palms together wherever the source's are."""
    theirs, ours = ([find_arm(motion.skeleton, side) for side in ("left", "right")] for motion in (source, moved))
    pose = forward_kinematics(source.skeleton, source.matrices().double(), torch.from_numpy(source.root).double())
    gap = _palm(pose, theirs[1]) - _palm(pose, theirs[0])
    size = sum(arm.length for arm in theirs) / 2
    weight = falloff(gap.norm(dim=-1, keepdim=True) / size, NEAR, FAR)
    if not bool((weight > 0).any()):
        return moved
    rotations = moved.matrices().double()
    pose = forward_kinematics(moved.skeleton, rotations, torch.from_numpy(moved.root).double())
    palms = [_palm(pose, arm) for arm in ours]
    middle = (palms[0] + palms[1]) / 2
    wanted = gap * (sum(arm.length for arm in ours) / 2 / size)
    for arm, palm, half in zip(ours, palms, (-0.5, 0.5), strict=True):
        rotations = move_hand(arm, rotations, pose, weight * (middle + half * wanted - palm))
    return replace(moved, rotations=quaternion_from_matrix(rotations).numpy().astype(np.float32))


def palms(motion: Motion) -> Float[Tensor, "t 2 3"]:
    """World positions of the left and the right palm."""
    pose = forward_kinematics(motion.skeleton, motion.matrices().double(), torch.from_numpy(motion.root).double())
    return torch.stack([_palm(pose, find_arm(motion.skeleton, side)) for side in ("left", "right")], 1)


def find_arm(skeleton: Skeleton, side: str) -> Arm:
    """The `left` or `right` arm of a rig with known bones."""
    bones = bone_map(skeleton)
    upper, lower, hand = (bones[side + name] for name in ("UpperArm", "LowerArm", "Hand"))
    rest = skeleton.rest_positions.double()
    knuckle = bones.get(f"{side}MiddleProximal", bones.get(f"{side}IndexProximal"))
    forearm = rest[hand] - rest[lower]
    to_knuckles = FOREARM * forearm if knuckle is None else rest[knuckle] - rest[hand]
    hinge = torch.linalg.cross(rest[lower] - rest[upper], torch.tensor([0.0, 0.0, 1.0]).double())
    return Arm(
        (skeleton.parents[upper], skeleton.parents[lower], skeleton.parents[hand]),
        upper,
        lower,
        hand,
        PALM * to_knuckles,
        float(to_knuckles.norm()),
        hinge / hinge.norm(),
    )


def _palm(pose: Pose, arm: Arm) -> Tensor:
    return pose.positions[:, arm.hand] + (pose.rotations[:, arm.hand] @ arm.palm)


def move_hand(
    arm: Arm, rotations: Float[Tensor, "t j 3 3"], pose: Pose, shift: Float[Tensor, "t 3"]
) -> Float[Tensor, "t j 3 3"]:
    """Local rotations with this arm bent so that its hand moves by `shift` and keeps its orientation."""
    place, world = pose.positions, pose.rotations
    shoulder, elbow, wrist = (place[:, joint] for joint in (arm.upper, arm.lower, arm.hand))
    upper, lower = elbow - shoulder, wrist - elbow
    bend = torch.linalg.cross(upper, lower) / (upper.norm(dim=-1) * lower.norm(dim=-1))[:, None]
    hinge = bend + _STRAIGHT * (world[:, arm.lower] @ arm.hinge)
    hinge = hinge / hinge.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    first, second = reach(hip=shoulder, knee=elbow, ankle=wrist, hinge=hinge, target=wrist + shift)
    above = first @ world[:, arm.upper]
    below = second @ world[:, arm.lower]
    bent = rotations.clone()
    over_upper, over_lower, over_hand = arm.above  # a rig may have extra joints in an arm
    bent[:, arm.upper] = world[:, over_upper].transpose(-1, -2) @ above
    bent[:, arm.lower] = (first @ world[:, over_lower]).transpose(-1, -2) @ below
    bent[:, arm.hand] = (second @ world[:, over_hand]).transpose(-1, -2) @ world[:, arm.hand]
    return torch.where((shift != 0).any(-1)[:, None, None, None], bent, rotations)
