"""Align the rest poses of two rigs, so that retargeting can copy world rotations.

Each mapped bone gets a constant rotation A with: target world rotation = source world rotation @ A. It leads from the
target's rest pose to ours and from ours to the source's (`rest_turns`), so any two rest poses match:

* Torso and shoulders differ in the facing alone.
* Limbs and fingers are rotated as the bone above, then by the smallest rotation that makes the directions equal.
* Hands are rotated as their knuckles lie: a palm may face down, ahead or the thigh.
* Feet and toes: A is measured on the motion, so that standing feet are flat on the floor and point as the source's do.

Some rigs have no meaningful rest pose: their bones all point along a local axis (Bandai-Namco). There A gives each bone
no twist against its parent on average over the clip. Elbows and knees take the twist from their bending axis.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np
from jaxtyping import Float

from .motion import Pose
from .rotations import least_rotation, length, unit
from .skeleton import HUMANOID, Skeleton

Array = np.ndarray
_LIMBS = ("Arm", "Hand", "Leg", "Thumb", "Index", "Middle", "Ring", "Little")
_HINGES = ("UpperArm", "LowerArm", "UpperLeg", "LowerLeg")
_TRUNK = ("spine", "chest", "upperChest")
_UP = (0.0, 1.0, 0.0)
_IN_LINE = 0.94  # cosine of 20 degrees
_AHEAD, _LEVEL = 0.5, 0.1  # least horizontal share of a foot's tip, and of its way to the toes, to tell its heading
_SHORT = 1.2e-3  # of the leg: the least length of a bone that has a direction
_BROAD = 0.05  # sine of the least angle between the outermost knuckles, seen from the wrist
_UPRIGHT = 0.5  # cosine of the largest lean, and twist between hips and shoulders, of a usable rest pose


def align(
    source: Skeleton, pose: Pose, source_map: Mapping[str, int], target: Skeleton, target_map: Mapping[str, int]
) -> dict[str, Float[Array, "3 3"]]:
    """The rotation A of each bone that both rigs have. `pose` is the source's motion in double precision."""
    bones = [bone for bone in target_map if bone in source_map]
    bones.sort(key=lambda bone: target_map[bone])
    feet = [bone for bone in bones if bone.endswith(("Foot", "Toes"))]
    found: dict[str, Array] = {}
    if has_rest_pose(source, source_map):
        theirs, own = rest_turns(source, source_map), rest_turns(target, target_map)
        found = {bone: theirs[bone] @ own[bone].T for bone in bones}
    for bone in feet:
        found[bone] = _flat(source, pose, source_map, bone) @ _heading(target, target_map, bone).T
    is_straight = _spine_begins_in_line(pose, source_map)
    least = [_SHORT * leg_length(*rig) for rig in ((target, target_map), (source, source_map))]
    for bone in bones:
        if bone in found:
            continue
        above = _mapped_parent(target, target_map, bone, found)
        ours, way = _direction(target, target_map, bone, least[0]), _direction(source, source_map, bone, least[1])
        mean = _mean_without_twist(pose.rotations[:, source_map[bone]], pose, source_map, found, above)
        if bone == "hips":
            rest = target.rest_positions.astype(np.float64)[None]
            still = Pose(np.tile(np.eye(3), (1, target.joints, 1, 1)), rest)
            found[bone] = _hips_frame(pose, source_map) @ _hips_frame(still, target_map).T
        elif ours is None or way is None or (bone in _TRUNK and not is_straight):
            found[bone] = mean
        elif bone.endswith(_HINGES):
            found[bone] = _from_hinge(pose, source_map, bone, ours, way)
        else:
            found[bone] = least_rotation(mean @ ours, way) @ mean
    return found


def rest_turns(skeleton: Skeleton, bones: Mapping[str, int]) -> dict[str, Float[Array, "3 3"]]:
    """The rotation of each bone from our rest pose to that of a rig that stands or sits upright, in the world."""
    facing, least = _facing(skeleton, bones), _SHORT * leg_length(skeleton, bones)
    found: dict[str, Array] = {}
    for bone in sorted(bones, key=lambda bone: bones[bone]):
        above = _mapped_parent(skeleton, bones, bone, found)
        base = facing if above is None else found[above]
        start, end = _our_direction(bone), _direction(skeleton, bones, bone, least)
        if bone.endswith(("Foot", "Toes")):
            found[bone] = _heading(skeleton, bones, bone)
        elif bone.endswith("Hand") and (turn := _palm_turn(skeleton, bones, bone)) is not None:
            found[bone] = turn
        elif start is None or end is None or not any(part in bone for part in _LIMBS):
            found[bone] = base
        else:
            found[bone] = least_rotation(base @ start, end) @ base
    return found


def project_rotation(matrix: Float[Array, "*n 3 3"]) -> Float[Array, "*n 3 3"]:
    """The rotation nearest to a matrix, for example to a mean of rotation matrices."""
    u, _, v = np.linalg.svd(matrix)
    v[..., 2, :] *= np.linalg.det(u @ v)[..., None]
    nearest: Array = u @ v
    return nearest


def _direction(skeleton: Skeleton, bones: Mapping[str, int], bone: str, least: float) -> Array | None:
    """Rest direction from a bone to the next one, in its own frame; None for a bone shorter than `least`."""
    joint = bones[bone]
    if bone.endswith("Hand"):
        named = [bones[name] for name in (f"{bone[:-4]}MiddleProximal", f"{bone[:-4]}IndexProximal") if name in bones]
        child = named[0] if named else None
    else:
        child = _next_joint(bones, bone)
    if child is not None:
        offset = np.zeros(3, np.float32)
        while child != joint:  # unmapped bones in between continue the direction
            if child < 0:
                return None
            offset = offset + skeleton.offsets[child]
            child = skeleton.parents[child]
    else:
        offset = np.array(skeleton.config.tips.get(skeleton.names[joint], (0, 0, 0)), np.float32)
    if bone.endswith("Distal") and child is None and np.linalg.norm(offset) < least:
        offset = skeleton.offsets[joint]  # a fingertip without an end continues its bone
    return unit(offset.astype(np.float64)) if np.linalg.norm(offset) > least else None


@cache
def _our_direction(bone: str) -> Array | None:
    """`_direction` of a bone of our rig; None for eyes and jaw, which it lacks."""
    ours = HUMANOID.config.vrm
    return _direction(HUMANOID, ours, bone, 0.0) if bone in ours else None


def _palm_turn(skeleton: Skeleton, bones: Mapping[str, int], hand: str) -> Array | None:
    """The rotation of a hand from our rest pose, by its outermost knuckles; None where they say nothing."""
    knuckles = [f"{hand[:-4]}{digit}Proximal" for digit in ("Index", "Middle", "Ring", "Little")]
    knuckles = [bone for bone in knuckles if bone in bones]
    if len(knuckles) < 2:
        return None
    frames = []
    for rig, joints in ((skeleton, bones), (HUMANOID, HUMANOID.config.vrm)):
        rest = rig.rest_positions.astype(np.float64)
        first, last = (unit(rest[joints[bone]] - rest[joints[hand]]) for bone in (knuckles[0], knuckles[-1]))
        if np.linalg.norm(np.cross(first, last)) < _BROAD:
            return None
        frames.append(_frame(first + last, first - last))
    turn: Array = frames[0] @ frames[1].T
    return turn


_FIRST_CHILD = {
    HUMANOID.names[parent]: HUMANOID.names[joint]
    for joint, parent in reversed(list(enumerate(HUMANOID.parents)))
    if parent >= 0
}


def _next_joint(bones: Mapping[str, int], bone: str) -> int | None:
    """The joint of the next bone outward or upward; a spine may lack some."""
    following = _FIRST_CHILD.get(bone, "")
    while following in _TRUNK and following not in bones:
        following = _FIRST_CHILD[following]
    return bones.get(following)


def _mapped_parent(target: Skeleton, bones: Mapping[str, int], bone: str, found: Mapping[str, Array]) -> str | None:
    names = {joint: name for name, joint in bones.items()}
    joint = target.parents[bones[bone]]
    while joint >= 0:
        if names.get(joint) in found:
            return names[joint]
        joint = target.parents[joint]
    return None


def leg_length(skeleton: Skeleton, bones: Mapping[str, int]) -> float:
    """Length of thigh and shin, mean of both sides, metres."""
    rest = skeleton.rest_positions  # not offsets: a rig may have extra joints in a bone
    chains = [[bones[f"{side}{bone}"] for bone in ("UpperLeg", "LowerLeg", "Foot")] for side in ("left", "right")]
    return float(sum(length(np.diff(rest[chain], axis=0)).sum() for chain in chains) / 2)


def has_rest_pose(source: Skeleton, bones: Mapping[str, int]) -> bool:
    """Whether the rest pose is a body's, standing or sitting: head over hips over feet, left and right apart."""
    rest, size = source.rest_positions, leg_length(source, bones)
    heights = [float(rest[bones[bone], 1]) for bone in ("head", "hips", "leftFoot")]
    is_descending = all(a > b + 0.12 * size for a, b in zip(heights, heights[1:], strict=False))
    hips, shoulders = (rest[bones[f"left{bone}"]] - rest[bones[f"right{bone}"]] for bone in ("UpperLeg", "UpperArm"))
    trunk, turn = unit(rest[bones["head"]] - rest[bones["hips"]]), (unit(hips) * unit(shoulders)).sum()
    is_wide = bool(np.linalg.norm(hips) > 0.06 * size)
    return is_descending and is_wide and float(trunk[1]) > _UPRIGHT and float(turn) > _UPRIGHT


def _spine_begins_in_line(pose: Pose, bones: Mapping[str, int]) -> bool:
    """Whether the way from hips to spine leads to the neck; in some rigs (ACCAD) the spine begins behind the hips."""
    if not {"spine", "neck"} <= bones.keys():
        return False
    places = [pose.positions[:, bones[bone]] for bone in ("hips", "spine", "neck")]
    first, whole = (unit(place - places[0]).mean(0) for place in places[1:])
    return float((unit(first) * unit(whole)).sum()) > _IN_LINE


def _facing(skeleton: Skeleton, bones: Mapping[str, int]) -> Array:
    """Rotation about the vertical from the facing of our rest pose to that of a rig's."""
    rest = skeleton.rest_positions.astype(np.float64)
    across = rest[bones["leftUpperLeg"]] - rest[bones["rightUpperLeg"]]
    return least_rotation(np.array([1.0, 0.0, 0.0]), across * [1, 0, 1])


def _flat(source: Skeleton, pose: Pose, bones: Mapping[str, int], bone: str) -> Array:
    """Mean rotation, in the bone's frame, to an upright frame that points along the foot, while that stands."""
    side = "left" if bone.startswith("left") else "right"
    ankle = pose.positions[:, bones[f"{side}Foot"]]
    stands = ankle[:, 1] <= np.quantile(ankle[:, 1], 0.15) + 0.01
    rotations = pose.rotations[stands, bones[bone]]
    ahead = _along_foot(source, pose, bones, side)[stands]
    return project_rotation((rotations.mT @ _level(ahead)).mean(0))


def _along_foot(source: Skeleton, pose: Pose, bones: Mapping[str, int], side: str) -> Float[Array, "t 3"]:
    """From the ankle to the toes or, without them, to the foot's tip; the heading of the hips if there is neither."""
    foot = bones[f"{side}Foot"]
    if f"{side}Toes" in bones:
        ahead: Array = pose.positions[:, bones[f"{side}Toes"]] - pose.positions[:, foot]
        least = _LEVEL
    else:
        tip = np.array(source.config.tips.get(source.names[foot], (0.0, 0.0, 0.0)))
        ahead, least = pose.rotations[:, foot] @ tip, _AHEAD
    if length(ahead[:, [0, 2]]).mean() > least * length(ahead).mean() > 0:
        return ahead
    across = pose.positions[:, bones["leftUpperLeg"]] - pose.positions[:, bones["rightUpperLeg"]]
    return np.cross(across, _UP)


def _heading(skeleton: Skeleton, bones: Mapping[str, int], bone: str) -> Array:
    """Rotation about the vertical to where a flat foot points at rest: as its toes do, or else as the hips face."""
    side = "left" if bone.startswith("left") else "right"
    foot, rest = bones[f"{side}Foot"], skeleton.rest_positions.astype(np.float64)
    ahead = rest[bones.get(f"{side}Toes", foot)] - rest[foot]
    return _level(ahead) if np.linalg.norm(ahead[[0, 2]]) > _LEVEL * np.linalg.norm(ahead) else _facing(skeleton, bones)


def _level(ahead: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Axes left, up, ahead of an upright frame that points along the horizontal part of `ahead`."""
    left = unit(np.cross(_UP, ahead))
    return np.stack([left, np.broadcast_to(_UP, left.shape), np.cross(left, _UP)], -1)


def _mean_without_twist(
    rotations: Array, pose: Pose, bones: Mapping[str, int], found: Mapping[str, Array], above: str | None
) -> Array:
    if above is None:
        return np.eye(3)
    parent = pose.rotations[:, bones[above]] @ found[above]
    return project_rotation((rotations.mT @ parent).mean(0))


def _hips_frame(pose: Pose, bones: Mapping[str, int]) -> Array:
    """The frame of the hips: +X from right to left hip joint, +Y as near to the neck as it is on average."""
    left, right, hips, neck = (
        pose.positions[:, bones[bone]]
        for bone in ("leftUpperLeg", "rightUpperLeg", "hips", "neck" if "neck" in bones else "head")
    )
    own = pose.rotations[:, bones["hips"]].mT
    across, up = ((own @ way[..., None])[..., 0].mean(0) for way in (left - right, neck - hips))
    return _frame(across, up)


def _from_hinge(pose: Pose, bones: Mapping[str, int], bone: str, ours: Array, theirs: Array) -> Array:
    """A from the bending axes: ours is -Y (left elbow), +Y (right elbow) or +X (knee); the source's is measured."""
    side, is_arm = ("left" if bone.startswith("left") else "right"), "Arm" in bone
    chain = ("UpperArm", "LowerArm", "Hand") if is_arm else ("UpperLeg", "LowerLeg", "Foot")
    a, b, c = (pose.positions[:, bones[side + name]] for name in chain)
    bend = np.cross(unit(b - a), unit(c - b))
    theirs_axis = (pose.rotations[:, bones[bone]].mT @ bend[..., None])[..., 0].mean(0)
    up = -1.0 if side == "left" else 1.0
    ours_axis = np.array([0.0, up, 0.0] if is_arm else [1.0, 0.0, 0.0])
    turn: Array = _frame(theirs, theirs_axis) @ _frame(ours, ours_axis).T
    return turn


def _frame(first: Array, second: Array) -> Array:
    x = unit(first)
    y = unit(second - (second * x).sum() * x)
    return np.stack([x, y, np.cross(x, y)], -1)
