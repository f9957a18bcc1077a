"""Keep hands on a body of other proportions where they touch the source's: a step of retargeting a clip.

Where a point of a hand is near torso, neck or head of the source, it is moved to the same place on the target's part,
in shares of the part's width, height and depth. The hand keeps its orientation. An arm that hangs straight touches the
hip by chance, so it is left to hang.
"""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ..kinematics import Motion, Pose, Skeleton, forward_kinematics
from ..kinematics.easing import falloff
from ..kinematics.hand_contact import find_arm, move_hand
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import quaternion_from_matrix
from .hand import hand_points
from .profile import BodyProfile, RoundedPart

NEAR, FAR = 0.3, 1.3  # hand lengths between hand and body: full effect up to NEAR, none from FAR on
HANGING, BENT = 0.45, 0.9  # bend of the elbow, radians: no effect up to HANGING, full effect from BENT on


def keep_hands_on_body(source: Motion, moved: Motion, theirs: BodyProfile, ours: BodyProfile) -> Motion:
    """`moved` (`source` on another rig) with its hands on its body wherever the source's are.

    The body of a source whose rest pose does not stand is not known; then nothing changes.
    """
    maps = [bone_map(motion.skeleton) for motion in (source, moved)]
    if not _stands(source.skeleton, maps[0]):
        return moved
    shared = maps[0].keys() & maps[1].keys()
    poses = [_pose(motion) for motion in (source, moved)]
    parts: list[str] = [
        part.bone for part in theirs.parts if part.bone in {p.bone for p in ours.parts} and part.bone in shared
    ]
    rotations = moved.matrices().double()
    bodies = [
        _body(profile, parts, bones, pose) for profile, bones, pose in zip((theirs, ours), maps, poses, strict=True)
    ]
    (places, centres, radii), (our_places, our_centres, our_radii) = bodies
    joints = [maps[1][bone] for bone in parts]
    axes = poses[1].rotations[:, joints]  # used for the source's parts too, because its rest pose may differ
    for side in ("left", "right"):
        arm = find_arm(source.skeleton, side)
        elbow = _bend(poses[0], arm.upper, arm.lower, arm.hand)
        hands = [
            _points(motion.skeleton, {name: bones[name] for name in shared}, side, pose, profile)
            for motion, bones, pose, profile in zip((source, moved), maps, poses, (theirs, ours), strict=True)
        ]
        (points, thick), (our_points, our_thick) = hands
        away = torch.einsum("teij,tpei->tpej", axes, points[:, :, None] - places[:, None]) - centres
        wide = radii + thick[:, None, None]
        unit = away / wide
        far = unit.norm(dim=-1)
        air = far * (far - 1) / (unit / wide).norm(dim=-1).clamp_min(1e-9)
        weight = falloff(air / arm.length, NEAR, FAR) * (1 - falloff(elbow, HANGING, BENT))[:, None, None]
        local = our_centres + unit * (our_radii + our_thick[:, None, None])
        wanted = our_places[:, None] + torch.einsum("teij,tpej->tpei", axes, local)
        share = weight.square()[..., None]
        shift = (share * (wanted - our_points[:, :, None])).sum((1, 2)) / share.sum((1, 2)).clamp_min(1e-9)
        rotations = move_hand(find_arm(moved.skeleton, side), rotations, poses[1], weight.amax((1, 2))[:, None] * shift)
    return replace(moved, rotations=quaternion_from_matrix(rotations).numpy().astype(np.float32))


def _pose(motion: Motion) -> Pose:
    return forward_kinematics(motion.skeleton, motion.matrices().double(), torch.from_numpy(motion.root).double())


def _stands(skeleton: Skeleton, bones: dict[str, int]) -> bool:
    height = skeleton.rest_positions[:, 1]
    return bool(height[bones["head"]] > height[bones["hips"]] > height[bones["leftFoot"]])


def _points(
    skeleton: Skeleton, bones: dict[str, int], side: str, pose: Pose, profile: BodyProfile
) -> tuple[Float[Tensor, "t p 3"], Float[Tensor, " p"]]:
    """World positions of a hand's points, and its half thickness there."""
    hand = hand_points(skeleton, bones, side)
    joints = [point.joint for point in hand]
    offsets = torch.from_numpy(np.array([point.offset for point in hand])).double()
    places = pose.positions[:, joints] + torch.einsum("tpij,pj->tpi", pose.rotations[:, joints], offsets)
    return places, torch.tensor([profile.palm if point.is_palm else profile.finger for point in hand]).double()


def _body(
    profile: BodyProfile, parts: list[str], bones: dict[str, int], pose: Pose
) -> tuple[Float[Tensor, "t e 3"], Float[Tensor, "e 3"], Float[Tensor, "e 3"]]:
    """World positions of the parts' bones; centres and radii of the parts in the bones' axes."""
    known: dict[str, RoundedPart] = {part.bone: part for part in profile.parts}
    centres = torch.tensor([known[bone].centre for bone in parts]).double()
    radii = torch.tensor([known[bone].radii for bone in parts]).double()
    return pose.positions[:, [bones[bone] for bone in parts]], centres, radii


def _bend(pose: Pose, shoulder: int, elbow: int, wrist: int) -> Float[Tensor, " t"]:
    """Radians between upper arm and forearm; 0 is straight."""
    upper = pose.positions[:, elbow] - pose.positions[:, shoulder]
    lower = pose.positions[:, wrist] - pose.positions[:, elbow]
    return torch.atan2(torch.linalg.cross(upper, lower).norm(dim=-1), (upper * lower).sum(-1))
