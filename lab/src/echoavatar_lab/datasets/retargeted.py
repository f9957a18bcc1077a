"""A recording on the rig of its set: on its own, annotated for training, or retargeted to ours.

Retargeting keeps bone directions, so on a rig with broader shoulders clapping or folded hands come apart. Where the
source's wrists are close, arm IK moves both of ours by half the way to the same vector between them, in arm lengths;
hands keep their orientation. The correction fades out with the distance between the hands, so motion does not jump.

`fidelity` measures how close a retargeted recording is to its source: foot contacts, distance of the hands, directions
of the body. Proportions differ between rigs, so hand distances are in arm lengths and feet are compared by contacts.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.ik.hand_contact import find_arm, move_hand
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.kinematics.easing import falloff
from echoavatar.motion.kinematics.foot_planting import foot_contacts
from echoavatar.motion.kinematics.joint_tree import SIDES
from echoavatar.motion.kinematics.joint_words import read_name
from echoavatar.motion.kinematics.retarget import with_wrists
from echoavatar.motion.kinematics.rigs import bone_map, feet_of
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar_lab.data.faults import skate
from echoavatar_lab.data.statistics import arm_length


def annotate_rig(motion: Motion) -> Motion:
    """The same motion on a skeleton with body parts, mirror pairs and feet.

    "lower" is the legs and the root, "hands" is everything below the hand bones, "upper" is the rest. Raises
    MotionError if the joint names are unknown, or left and right cannot be paired.
    """
    skeleton, bones = motion.skeleton, bone_map(motion.skeleton)
    thighs = {bones["leftUpperLeg"], bones["rightUpperLeg"]}
    wrists = {bones["leftHand"], bones["rightHand"]}
    above_hips = _line(skeleton, bones["hips"])
    lower, hands = [0], []
    for joint in range(1, skeleton.joints):
        above = _line(skeleton, joint)
        if above & thighs or joint in above_hips:
            lower.append(joint)
        elif (above - {joint}) & wrists:
            hands.append(joint)
    upper = [joint for joint in range(skeleton.joints) if joint not in {*lower, *hands}]
    parts = {"lower": tuple(lower), "upper": tuple(upper), "hands": tuple(hands)}
    config = skeleton.config.model_copy(
        update={
            "parts": {name: joints for name, joints in parts.items() if joints},
            "mirror": _pairs(skeleton, bones),
            "feet": tuple(feet_of(bones)),
            "vrm": bones,
        }
    )
    return Motion(Skeleton(config), motion.rotations, motion.root, motion.fps)


def _line(skeleton: Skeleton, joint: int) -> set[int]:
    """A joint and its ancestors."""
    line = set()
    while joint >= 0:
        line.add(joint)
        joint = skeleton.parents[joint]
    return line


def _pairs(skeleton: Skeleton, bones: dict[str, int]) -> tuple[int, ...]:
    """For each joint that of the other side: by the bones, elsewhere by names that differ in the side alone."""
    said = [read_name(name) for name in skeleton.names]
    pairs = list(range(skeleton.joints))
    for joint, one in enumerate(said):
        others = [
            k for k, other in enumerate(said) if other.plain == one.plain and {one.side, other.side} == set(SIDES)
        ]
        if len(others) == 1:
            pairs[joint] = others[0]
    for bone, joint in bones.items():
        if (other := bones.get(f"right{bone.removeprefix('left')}")) is not None and bone.startswith("left"):
            pairs[joint], pairs[other] = other, joint
    if any(pairs[pairs[joint]] != joint for joint in range(len(pairs))):
        raise MotionError(
            f"left and right of the rig with joints {', '.join(skeleton.names[:3])}, ... cannot be told from its names;"
            " use --rig unified"
        )
    return tuple(pairs)


NEAR_ARMS, FAR_ARMS = 0.35, 0.8
"""Arm lengths between the wrists: below the first full correction, above the second none."""


def keep_hand_contact(motion: Motion, source: Motion) -> Motion:
    """The motion with hands as close together as in the source, where they are close there.

    Args:
        motion: on our rig, retargeted from `source`.
        source: the same frames on the recording's own rig.
    """
    length = arm_length(motion.skeleton)
    wanted = _between(source) / arm_length(source.skeleton) * length
    weight = falloff(np.linalg.norm(wanted, axis=-1) / length, NEAR_ARMS, FAR_ARMS)
    if float(weight.max()) == 0:
        return motion
    step = (wanted - _between(motion)) * weight[:, None] / 2
    rotations, pose = motion.matrices().astype(np.float64), motion.pose(np.float64)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rotations = move_hand(find_arm(motion.skeleton, side), rotations, pose, sign * step)
    return replace(motion, rotations=quaternion_from_matrix(rotations).astype(np.float32))


def _between(motion: Motion) -> Float[np.ndarray, "t 3"]:
    """Vector from the right wrist to the left, metres, world axes."""
    bones, places = bone_map(motion.skeleton), motion.pose().positions.astype(np.float64)
    return places[:, bones["leftHand"]] - places[:, bones["rightHand"]]


def _both_sides(*lines: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    return tuple((side + a, side + b) for side in ("left", "right") for a, b in lines)


LINES: dict[str, tuple[tuple[str, str], ...]] = {
    "arm": _both_sides(("UpperArm", "LowerArm"), ("LowerArm", "Hand")),
    "leg": _both_sides(("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")),
    "trunk": (("hips", "head"),),
    "shoulders": (("rightUpperArm", "leftUpperArm"),),
}
_Array = np.ndarray


def fidelity(source: Motion, result: Motion) -> dict[str, float]:
    """Compare source and result frame by frame; both have the same frame rate.

    `contacts_agree` is the share of frames and feet in which both bodies or neither have contact with heel or toes
    (`footing.foot_contacts`). `hands_apart_error` is the mean difference of the distance between the wrists, in arm
    lengths of each body; `hands_together_error` is the same over frames in which the source's wrists are close.
    `arm_angle_deg` is the mean angle between the directions of upper arms and forearms, `leg_angle_deg` of thighs and
    shins, `trunk_angle_deg` of the line from hips to head, `shoulders_angle_deg` of the line between the shoulders;
    rigs differ by some degrees in trunk and shoulders. Skating is in centimetres per second.
    """
    frames = min(source.frames, result.frames)
    a, b = with_wrists(source).cut(0, frames), result.cut(0, frames)
    stands_a, stands_b = foot_contacts(a)[..., 1], foot_contacts(b)[..., 1]
    hands_a, hands_b = _hands_apart(a), _hands_apart(b)
    together = hands_a < NEAR_ARMS
    numbers = {
        "contacts_agree": float((stands_a == stands_b).mean()),
        "planted_source": float(stands_a.mean()),
        "planted": float(stands_b.mean()),
        "skate_source_cm_s": skate(_feet(a), a.fps),
        "skate_cm_s": skate(_feet(b), b.fps),
        "hands_apart_error": float(np.abs(hands_a - hands_b).mean()),
        "hands_together": float(together.mean()),
        "hands_together_error": float(np.abs(hands_a - hands_b)[together].mean()) if together.any() else 0.0,
        **{f"{part}_angle_deg": _angle_deg(a, b, lines) for part, lines in LINES.items()},
    }
    return {name: round(value, 4) for name, value in numbers.items()}


def _feet(motion: Motion) -> _Array:
    """(t, 4, 3): left ankle and toes, right ankle and toes; a rig without toes repeats the ankle."""
    return _places(motion, feet_of(bone_map(motion.skeleton)))


def _places(motion: Motion, joints: Sequence[int]) -> _Array:
    return motion.pose().positions[:, joints].astype(np.float64)


def _hands_apart(motion: Motion) -> _Array:
    """Distance between the wrists in arm lengths."""
    apart: _Array = np.linalg.norm(_between(motion), axis=-1) / arm_length(motion.skeleton)
    return apart


def _angle_deg(a: Motion, b: Motion, lines: tuple[tuple[str, str], ...]) -> float:
    """Mean angle between the directions of some lines of two bodies."""
    ways = []
    for motion in (a, b):
        bones = bone_map(motion.skeleton)
        ends = _places(motion, [bones[name] for line in lines for name in line]).reshape(motion.frames, -1, 2, 3)
        ways.append(ends[:, :, 1] - ends[:, :, 0])
    one, other = (way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways)
    return float(np.degrees(np.arccos(np.clip((one * other).sum(-1), -1, 1))).mean())
