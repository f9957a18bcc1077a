"""The points that represent a hand: wrist, middle of the palm, knuckles and fingertips."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton

LEAN = ("", "ThumbProximal", "IndexProximal", "LittleProximal", "IndexIntermediate", "LittleIntermediate")
LEAN_TIPS = ("ThumbDistal", "IndexDistal", "MiddleDistal", "RingDistal", "LittleDistal")
_DIGITS = ("Thumb", "Index", "Middle", "Ring", "Little")
FULL = ("", *(f"{digit}{part}" for digit in _DIGITS for part in ("Proximal", "Intermediate", "Distal")))
FULL_TIPS = tuple(f"{digit}Distal" for digit in _DIGITS)
PALM_PLACE = 0.5  # of the way from wrist to knuckles
FINGERLESS = (0.35, 0.70)  # palm and fingertips of a rig without fingers, in forearm lengths beyond the wrist


class HandPoint(NamedTuple):
    """A point of a hand: its joint, its offset in the joint's frame (metres), and whether it is palm or finger."""

    joint: int
    offset: Float[np.ndarray, " 3"]
    is_palm: bool


def hand_points(skeleton: Skeleton, bones: dict[str, int], side: str, *, is_full: bool = False) -> list[HandPoint]:
    """Points of one hand; the second is the middle of the palm. A rig without fingers gets points along the hand."""
    rest = skeleton.rest_positions.numpy()
    wrist = bones[f"{side}Hand"]
    forearm = rest[wrist] - rest[bones[f"{side}LowerArm"]]
    joints, tips = (FULL, FULL_TIPS) if is_full else (LEAN, LEAN_TIPS)
    knuckle = next((bones[name] for d in ("Middle", "Index") if (name := f"{side}{d}Proximal") in bones), None)
    along = FINGERLESS[0] * forearm if knuckle is None else PALM_PLACE * (rest[knuckle] - rest[wrist])
    points = [HandPoint(wrist, np.zeros(3), True), HandPoint(wrist, along, True)]
    if knuckle is None:
        points.append(HandPoint(wrist, FINGERLESS[1] * forearm, False))
    for name in joints[1:]:
        if (joint := bones.get(f"{side}{name}")) is not None:
            points.append(HandPoint(joint, np.zeros(3), name in ("IndexProximal", "LittleProximal")))
    for name in tips:
        if (joint := bones.get(f"{side}{name}")) is not None:
            tip = skeleton.config.tips.get(skeleton.names[joint])
            end = 0.8 * (rest[joint] - rest[skeleton.parents[joint]]) if tip is None else np.array(tip)
            points.append(HandPoint(joint, end, False))
    return points
