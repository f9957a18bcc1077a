"""When a clip is retargeted to another body, keep the hands on each other and on the body where the source has them.

If only rotations are retargeted, a clap makes long arms pass through each other, and short arms never meet. Where the
source's palms are near each other, the target's palms get the same offset from each other, scaled by the size of the
hands, about their own midpoint. Where a point of a hand is near torso, neck or head of the source, it is moved to the
same place on the target's part, in shares of the part's width, height and depth. An arm that hangs straight touches the
hip by chance, so it is left to hang. Both arms bend by closed-form IK, and the hands keep their orientation.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..kinematics import Motion, Pose, Skeleton
from ..kinematics.alignment import has_rest_pose
from ..kinematics.easing import falloff
from ..kinematics.joint_tree import SIDES
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import length, quaternion_from_matrix, unit
from ..kinematics.two_bone import Limb, bend_limb
from .hand_collisions import hand_points
from .profile import BodyProfile, RoundedPart

NEAR, FAR = 1.3, 3.5  # hand lengths between the palms: full effect up to NEAR, none from FAR on
SKIN_NEAR, SKIN_FAR = 0.3, 1.3  # hand lengths between hand and body: full effect up to SKIN_NEAR, none from SKIN_FAR on
HANGING, BENT = 0.45, 0.9  # bend of the elbow, radians: no effect up to HANGING, full effect from BENT on
FOREARM = 0.37  # length of a hand without knuckles, as a share of the forearm
PALM = 0.8  # where the palm is on the way from the wrist to the knuckles
_STRAIGHT = 0.15  # weight of the rest pose's hinge, which gives the bending axis of a nearly straight elbow


class Arm(NamedTuple):
    """The joints of an arm, its palm, and how its elbow bends."""

    limb: Limb
    palm: Float[np.ndarray, "3"]  # from the wrist, in the hand's frame
    length: float  # from wrist to knuckles
    hinge: Float[np.ndarray, "3"]  # axis about which the elbow flexes, at rest


def keep_hands_together(source: Motion, moved: Motion) -> Motion:
    """`moved` (`source` on another rig) with its palms together wherever the source's are."""
    theirs, ours = ([find_arm(motion.skeleton, side) for side in SIDES] for motion in (source, moved))
    pose = source.pose(np.float64)
    gap = _palm(pose, theirs[1]) - _palm(pose, theirs[0])
    size = sum(arm.length for arm in theirs) / 2
    weight = falloff(length(gap) / size, NEAR, FAR)
    if not (weight > 0).any():
        return moved
    rotations, pose = moved.matrices().astype(np.float64), moved.pose(np.float64)
    palms = [_palm(pose, arm) for arm in ours]
    middle = (palms[0] + palms[1]) / 2
    wanted = gap * (sum(arm.length for arm in ours) / 2 / size)
    for arm, palm, half in zip(ours, palms, (-0.5, 0.5), strict=True):
        rotations = move_hand(arm, rotations, pose, weight * (middle + half * wanted - palm))
    return replace(moved, rotations=quaternion_from_matrix(rotations).astype(np.float32))


def find_arm(skeleton: Skeleton, side: str) -> Arm:
    """The `left` or `right` arm of a rig with known bones."""
    bones = bone_map(skeleton)
    upper, lower, hand = (bones[side + name] for name in ("UpperArm", "LowerArm", "Hand"))
    rest = skeleton.rest_positions.astype(np.float64)
    knuckle = bones.get(f"{side}MiddleProximal", bones.get(f"{side}IndexProximal"))
    forearm = rest[hand] - rest[lower]
    to_knuckles = FOREARM * forearm if knuckle is None else rest[knuckle] - rest[hand]
    hinge = np.cross(rest[lower] - rest[upper], [0.0, 0.0, 1.0])
    limb = Limb.of(skeleton, (upper, lower, hand))
    return Arm(limb, PALM * to_knuckles, float(np.linalg.norm(to_knuckles)), hinge / length(hinge))


def _palm(pose: Pose, arm: Arm) -> np.ndarray:
    hand = arm.limb.joints[2]
    place: np.ndarray = pose.positions[:, hand] + pose.rotations[:, hand] @ arm.palm
    return place


def move_hand(
    arm: Arm, rotations: Float[np.ndarray, "t j 3 3"], pose: Pose, shift: Float[np.ndarray, "t 3"]
) -> Float[np.ndarray, "t j 3 3"]:
    """Local rotations with this arm bent so that its hand moves by `shift` and keeps its orientation."""
    _, elbow, hand = arm.limb.joints
    upper, lower, wrist = _bones(pose, arm)
    bend = np.cross(upper, lower) / (length(upper) * length(lower))
    hinge = bend + _STRAIGHT * (pose.rotations[:, elbow] @ arm.hinge)
    hinge = unit(hinge, 1e-9)
    end = pose.rotations[:, hand]
    bent = bend_limb(arm.limb, rotations, pose, hinge=hinge, target=wrist + shift, end=end)
    return np.where((shift != 0).any(-1)[:, None, None, None], bent, rotations)


def keep_hands_on_body(source: Motion, moved: Motion, theirs: BodyProfile, ours: BodyProfile) -> Motion:
    """`moved` (`source` on another rig) with its hands on its body wherever the source's are.

    Nothing changes if the source's rest pose does not stand upright, because its body is then not known.
    """
    maps = [bone_map(motion.skeleton) for motion in (source, moved)]
    if not has_rest_pose(source.skeleton, maps[0]):
        return moved
    shared = maps[0].keys() & maps[1].keys()
    poses = [motion.pose(np.float64) for motion in (source, moved)]
    parts: list[str] = [
        part.bone for part in theirs.parts if part.bone in {p.bone for p in ours.parts} and part.bone in shared
    ]
    rotations = moved.matrices().astype(np.float64)
    bodies = [
        _body(profile, parts, bones, pose) for profile, bones, pose in zip((theirs, ours), maps, poses, strict=True)
    ]
    (places, centres, radii), (our_places, our_centres, our_radii) = bodies
    joints = [maps[1][bone] for bone in parts]
    axes = poses[1].rotations[:, joints]  # used for the source's parts too, because its rest pose may differ
    for side in SIDES:
        arm = find_arm(source.skeleton, side)
        elbow = _bend(poses[0], arm)
        hands = [
            _points(motion.skeleton, {name: bones[name] for name in shared}, side, pose, profile)
            for motion, bones, pose, profile in zip((source, moved), maps, poses, (theirs, ours), strict=True)
        ]
        (points, thick), (our_points, our_thick) = hands
        away = np.einsum("teij,tpei->tpej", axes, points[:, :, None] - places[:, None]) - centres
        wide = radii + thick[:, None, None]
        ball = away / wide
        far = length(ball)[..., 0]
        air = far * (far - 1) / np.maximum(length(ball / wide)[..., 0], 1e-9)
        weight = falloff(air / arm.length, SKIN_NEAR, SKIN_FAR) * (1 - falloff(elbow, HANGING, BENT))[:, None, None]
        local = our_centres + ball * (our_radii + our_thick[:, None, None])
        wanted = our_places[:, None] + np.einsum("teij,tpej->tpei", axes, local)
        share = (weight**2)[..., None]
        shift = (share * (wanted - our_points[:, :, None])).sum((1, 2)) / np.maximum(share.sum((1, 2)), 1e-9)
        rotations = move_hand(find_arm(moved.skeleton, side), rotations, poses[1], weight.max((1, 2))[:, None] * shift)
    return replace(moved, rotations=quaternion_from_matrix(rotations).astype(np.float32))


def _points(
    skeleton: Skeleton, bones: dict[str, int], side: str, pose: Pose, profile: BodyProfile
) -> tuple[Float[np.ndarray, "t p 3"], Float[np.ndarray, " p"]]:
    """World positions of a hand's points, and its half thickness there."""
    hand = hand_points(skeleton, bones, side)
    joints = [point.joint for point in hand]
    offsets = np.array([point.offset for point in hand], np.float64)
    places = pose.positions[:, joints] + np.einsum("tpij,pj->tpi", pose.rotations[:, joints], offsets)
    return places, np.array([profile.palm if point.is_palm else profile.finger for point in hand])


def _body(
    profile: BodyProfile, parts: list[str], bones: dict[str, int], pose: Pose
) -> tuple[Float[np.ndarray, "t e 3"], Float[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]:
    """World positions of the parts' bones; centres and radii of the parts in the bones' axes."""
    known: dict[str, RoundedPart] = {part.bone: part for part in profile.parts}
    centres = np.array([known[bone].centre for bone in parts])
    radii = np.array([known[bone].radii for bone in parts])
    return pose.positions[:, [bones[bone] for bone in parts]], centres, radii


def _bones(pose: Pose, arm: Arm) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]]:
    """The vectors along upper arm and forearm, and the position of the wrist."""
    shoulder, elbow, wrist = (pose.positions[:, joint] for joint in arm.limb.joints)
    return elbow - shoulder, wrist - elbow, wrist


def _bend(pose: Pose, arm: Arm) -> Float[np.ndarray, " t"]:
    """Radians between upper arm and forearm; 0 is straight."""
    upper, lower, _ = _bones(pose, arm)
    bend: np.ndarray = np.arctan2(length(np.cross(upper, lower))[..., 0], (upper * lower).sum(-1))
    return bend
