"""Annotates a recording's own skeleton for training: body parts, mirror pairs, feet, VRM bones."""

import re

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.kinematics.rigs import bone_map

_SIDES = (("left", "right"), ("Left", "Right"), ("_L", "_R"), ("_l", "_r"), ("L_", "R_"), ("l_", "r_"))


def annotate_rig(motion: Motion) -> Motion:
    """The same motion on a skeleton with body parts, mirror pairs and feet.

    "lower" is the legs and the root, "hands" is everything below the hand bones, "upper" is the rest.

    Raises:
        MotionError: the joint names are unknown, or left and right cannot be paired.
    """
    skeleton, bones = motion.skeleton, bone_map(motion.skeleton)
    thighs = {bones["leftUpperLeg"], bones["rightUpperLeg"]}
    wrists = {bones["leftHand"], bones["rightHand"]}
    lower, hands = [0], []
    for joint in range(1, skeleton.joints):
        above = _line(skeleton, joint)
        if above & thighs or bones["hips"] in _below(skeleton, joint):
            lower.append(joint)
        elif (above - {joint}) & wrists:
            hands.append(joint)
    upper = [joint for joint in range(skeleton.joints) if joint not in {*lower, *hands}]
    parts = {"lower": tuple(lower), "upper": tuple(upper), "hands": tuple(hands)}
    feet = [bones.get(name, bones[name.replace("Toes", "Foot")]) for name in _FEET]
    config = skeleton.config.model_copy(
        update={
            "parts": {name: joints for name, joints in parts.items() if joints},
            "mirror": _pairs(skeleton),
            "feet": tuple(feet),
            "vrm": bones,
        }
    )
    return Motion(Skeleton(config), motion.rotations, motion.root, motion.fps)


_FEET = ("leftFoot", "leftToes", "rightFoot", "rightToes")


def _line(skeleton: Skeleton, joint: int) -> set[int]:
    """A joint and its ancestors."""
    line = set()
    while joint >= 0:
        line.add(joint)
        joint = skeleton.parents[joint]
    return line


def _below(skeleton: Skeleton, joint: int) -> set[int]:
    """A joint and its descendants."""
    return {other for other in range(skeleton.joints) if joint in _line(skeleton, other)}


def _pairs(skeleton: Skeleton) -> tuple[int, ...]:
    names = {name: joint for joint, name in enumerate(skeleton.names)}
    pairs = []
    for joint, name in enumerate(skeleton.names):
        others = {_swapped(name, a, b) for a, b in _SIDES} | {_swapped(name, b, a) for a, b in _SIDES}
        found = [names[other] for other in others - {name} if other in names]
        pairs.append(found[0] if len(found) == 1 else joint)
    if any(pairs[pairs[joint]] != joint for joint in range(len(pairs))):
        raise MotionError(
            f"left and right of the rig with joints {', '.join(skeleton.names[:3])}, ... cannot be told from its names;"
            " use --rig unified"
        )
    return tuple(pairs)


def _swapped(name: str, one: str, other: str) -> str:
    """The name with its side mark replaced, where that stands at the start or end of a word."""
    if one.startswith("_"):
        return re.sub(f"{one}(?=_|$|[A-Z])", other, name)
    if one.endswith("_"):
        return re.sub(f"(?<![A-Za-z]){one}", other, name)
    return name.replace(one, other, 1)
