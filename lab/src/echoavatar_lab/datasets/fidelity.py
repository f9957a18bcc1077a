"""How close a retargeted recording is to its source: foot contacts, distance of the hands, directions of the body.

Proportions differ between rigs, so hand distances are in arm lengths and feet are compared by their contacts.
"""

import numpy as np

from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.foot_planting import foot_contacts
from echoavatar.motion.kinematics.retarget import with_wrists
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar_lab.data.faults import skate

from .hand_contact import NEAR_ARMS, arm_length

_SIDES = ("left", "right")
LINES: dict[str, tuple[tuple[str, str], ...]] = {
    "arm": tuple((s + a, s + b) for s in _SIDES for a, b in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"))),
    "leg": tuple((s + a, s + b) for s in _SIDES for a, b in (("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))),
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
    bones = bone_map(motion.skeleton)
    toes = [f"{side}Toes" if f"{side}Toes" in bones else f"{side}Foot" for side in ("left", "right")]
    return _places(motion, ("leftFoot", toes[0], "rightFoot", toes[1]))


def _places(motion: Motion, names: tuple[str, ...]) -> _Array:
    bones = bone_map(motion.skeleton)
    return motion.pose().positions[:, [bones[name] for name in names]].numpy().astype(np.float64)


def _hands_apart(motion: Motion) -> _Array:
    """Distance between the wrists in arm lengths."""
    hands = _places(motion, ("leftHand", "rightHand"))
    apart: _Array = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=-1) / arm_length(motion)
    return apart


def _angle_deg(a: Motion, b: Motion, lines: tuple[tuple[str, str], ...]) -> float:
    """Mean angle between the directions of some lines of two bodies."""
    names = tuple(name for line in lines for name in line)
    ways = [np.diff(_places(motion, names).reshape(motion.frames, -1, 2, 3), axis=2)[:, :, 0] for motion in (a, b)]
    one, other = (way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways)
    return float(np.degrees(np.arccos(np.clip((one * other).sum(-1), -1, 1))).mean())
