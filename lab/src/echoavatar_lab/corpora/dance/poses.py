"""Named arm poses of the dance (wrist, hand angles, elbow, clavicle, hand shape) and the moves made of them.

Wrists are in mirrored chest axes from the shoulder joint (x outwards, y up, z forwards, metres); angles as in
`Controls`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]

HANDS: dict[str, tuple[float, ...]] = {  # curl thumb, index, middle, ring, little; spread; opposition
    "relaxed": (0.25, 0.20, 0.26, 0.30, 0.33, 0.05, 0.25),
    "fist": (0.65, 0.92, 0.92, 0.92, 0.92, 0.0, 0.7),
    "loose_fist": (0.45, 0.55, 0.62, 0.66, 0.68, 0.0, 0.5),
    "open": (0.05, 0.03, 0.03, 0.05, 0.08, 0.7, 0.05),
    "flat": (0.15, 0.05, 0.05, 0.06, 0.08, -0.4, 0.15),
    "ballet": (0.30, 0.08, 0.24, 0.22, 0.14, 0.15, 0.50),
    "snap": (0.50, 0.45, 0.62, 0.85, 0.90, 0.0, 0.9),
    "point": (0.45, 0.02, 0.85, 0.90, 0.92, 0.0, 0.7),
    "two": (0.55, 0.02, 0.02, 0.90, 0.92, 0.6, 0.8),
    "three": (0.60, 0.02, 0.02, 0.04, 0.90, 0.6, 0.9),
    "thumb_up": (0.0, 0.92, 0.92, 0.92, 0.92, 0.0, 0.0),
}


@dataclass(frozen=True)
class ArmPose:
    """One arm: wrist, hand angles (flex, deviation, pronation), elbow swivel, clavicle (lift, forward), hand shape."""

    wrist: Triple
    palm: Triple = (0.0, 0.0, 0.2)
    elbow: float = 0.0
    shoulder: tuple[float, float] = (0.0, 0.0)
    hand: str = "relaxed"

    def vector(self) -> NDArray[np.float64]:
        """Wrist 3, palm 3, elbow 1, shoulder 2, fingers 7: (16,)."""
        return np.array([*self.wrist, *self.palm, self.elbow, *self.shoulder, *HANDS[self.hand]])


ARMS: dict[str, ArmPose] = {
    "loose": ArmPose((0.10, -0.31, 0.22), (0.05, 0.0, 0.35), hand="loose_fist"),
    "guard": ArmPose((0.02, -0.16, 0.27), (0.0, 0.0, 0.3), hand="loose_fist"),
    "fore": ArmPose((0.02, -0.23, 0.33), (0.0, 0.0, 0.1), hand="loose_fist", shoulder=(0.0, 0.12)),
    "back": ArmPose((0.14, -0.37, -0.13), (0.1, 0.0, 0.3), hand="loose_fist", shoulder=(0.02, -0.12)),
    "chest": ArmPose((-0.05, -0.12, 0.27), (0.0, 0.0, 0.6), 0.25),
    "punch": ArmPose((-0.09, -0.01, 0.46), (0.0, 0.0, 0.9), 0.2, (0.06, 0.25), "fist"),
    "chamber": ArmPose((0.09, -0.20, 0.13), (0.0, 0.0, 0.0), 0.1, (0.0, -0.1), "fist"),
    "side": ArmPose((0.45, -0.03, 0.10), (0.0, 0.0, 0.5), 0.0, (0.08, 0.0), "flat"),
    "side_high": ArmPose((0.40, 0.12, 0.12), (-0.15, 0.0, 0.5), 0.0, (0.15, 0.0), "open"),
    "side_low": ArmPose((0.34, -0.27, 0.12), (-0.1, 0.0, 0.5), 0.1, (0.0, 0.0), "open"),
    "vee": ArmPose((0.24, 0.37, 0.10), (-0.1, 0.0, 0.2), 0.0, (0.35, 0.0), "open"),
    "up": ArmPose((0.08, 0.43, 0.12), (0.0, 0.0, 0.2), 0.0, (0.45, 0.0), "open"),
    "up_bent": ArmPose((0.20, 0.20, 0.20), (-0.5, 0.0, 0.5), 0.1, (0.2, 0.0), "flat"),
    "point_up": ArmPose((0.28, 0.34, 0.16), (0.0, 0.0, 0.4), 0.0, (0.3, 0.0), "point"),
    "point_down": ArmPose((-0.16, -0.30, 0.32), (0.0, 0.0, 0.6), 0.1, (0.0, 0.2), "point"),
    "clap": ArmPose((-0.085, -0.12, 0.33), (0.05, 0.0, 0.0), 0.1, (0.0, 0.1), "flat"),
    "unclap": ArmPose((0.12, -0.13, 0.30), (-0.15, 0.0, 0.1), 0.15, (0.0, 0.0), "open"),
    "high_clap": ArmPose((-0.075, 0.36, 0.22), (0.0, 0.0, 0.0), 0.1, (0.35, 0.1), "flat"),
    "across": ArmPose((-0.24, -0.12, 0.31), (0.0, 0.0, 0.6), 0.15, (0.0, 0.2)),
    "across_low": ArmPose((-0.22, -0.28, 0.27), (0.0, 0.0, 0.6), 0.1, (0.0, 0.2)),
    "hip": ArmPose((0.10, -0.32, 0.05), (0.45, 0.0, 0.6), 0.3, (0.02, 0.0), "relaxed"),
    "salsa_front": ArmPose((0.02, -0.15, 0.32), (0.0, 0.0, 0.5), 0.25, (0.0, 0.1), "loose_fist"),
    "salsa_back": ArmPose((0.13, -0.21, 0.15), (0.0, 0.0, 0.4), 0.3, (0.03, -0.1), "loose_fist"),
    "snap": ArmPose((0.30, 0.0, 0.24), (-0.2, 0.0, 0.3), 0.1, (0.06, 0.0), "snap"),
    "snap_in": ArmPose((0.12, -0.16, 0.27), (0.15, 0.0, 0.4), 0.1, (0.0, 0.0), "loose_fist"),
    "frame_left": ArmPose((0.34, -0.02, 0.28), (0.0, 0.0, 0.2), 0.35, (0.08, 0.0), "relaxed"),
    "frame_right": ArmPose((0.08, -0.08, 0.31), (0.1, 0.0, 0.5), 0.5, (0.06, 0.05), "flat"),
    "bras_bas": ArmPose((-0.03, -0.38, 0.20), (0.15, 0.0, -0.2), 0.35, (0.0, 0.05), "ballet"),
    "first": ArmPose((-0.05, -0.14, 0.33), (0.15, 0.0, -0.1), 0.4, (0.0, 0.1), "ballet"),
    "second": ArmPose((0.40, -0.09, 0.20), (0.05, 0.0, 0.1), 0.25, (0.06, 0.0), "ballet"),
    "fifth": ArmPose((-0.01, 0.40, 0.17), (0.15, 0.0, 0.1), 0.2, (0.38, 0.0), "ballet"),
    "demi": ArmPose((0.26, -0.28, 0.22), (0.0, 0.0, 0.2), 0.25, (0.0, 0.0), "ballet"),
    "reach": ArmPose((0.05, 0.10, 0.44), (-0.1, 0.0, 0.7), 0.1, (0.12, 0.15), "ballet"),
    "circle_top": ArmPose((-0.05, -0.02, 0.30), (0.1, 0.0, 0.7), 0.2, (0.05, 0.0), "loose_fist"),
    "circle_front": ArmPose((-0.05, -0.13, 0.38), (0.0, 0.0, 0.7), 0.2, (0.0, 0.1), "loose_fist"),
    "circle_low": ArmPose((-0.05, -0.25, 0.30), (0.0, 0.0, 0.7), 0.2, (0.0, 0.0), "loose_fist"),
    "circle_near": ArmPose((-0.05, -0.13, 0.22), (0.1, 0.0, 0.7), 0.2, (0.0, 0.0), "loose_fist"),
    "wave_high": ArmPose((0.42, 0.10, 0.14), (0.3, 0.0, 0.8), 0.1, (0.18, 0.0), "flat"),
    "wave_low": ArmPose((0.41, -0.14, 0.14), (-0.35, 0.0, 0.8), 0.1, (0.0, 0.0), "flat"),
    "sway_in": ArmPose((0.0, 0.40, 0.16), (0.1, 0.0, 0.3), 0.0, (0.4, 0.0), "open"),
    "sway_out": ArmPose((0.27, 0.33, 0.16), (-0.1, 0.0, 0.3), 0.0, (0.3, 0.0), "open"),
    "shrug": ArmPose((0.20, -0.34, 0.16), (-0.1, 0.0, 0.3), 0.1, (0.22, 0.06), "open"),
    "unshrug": ArmPose((0.20, -0.38, 0.16), (-0.1, 0.0, 0.3), 0.1, (-0.08, -0.08), "open"),
    "push": ArmPose((0.0, -0.08, 0.42), (-0.8, 0.0, 0.9), 0.1, (0.0, 0.2), "flat"),
    "pull": ArmPose((0.06, -0.12, 0.22), (-0.4, 0.0, 0.7), 0.15, (0.0, -0.1), "flat"),
}


@dataclass(frozen=True)
class Key:
    """Poses reached on a count: arm poses by name; chest on pelvis and head as yaw, pitch, roll."""

    count: float
    left: str
    right: str
    chest: Triple = (0.0, 0.0, 0.0)
    head: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Move:
    """A pattern of keys; `travel` is how many counts a pose takes to reach, `flow` smooths the stops."""

    name: str
    counts: int
    keys: tuple[Key, ...]
    energy: tuple[float, float] = (0.0, 1.0)
    styles: tuple[str, ...] = ()
    travel: float = 0.8
    flow: float = 0.0
    exact: bool = False  # never scaled, because the hands touch
    is_fixed: bool = False  # never mirrored


def mirrored(move: Move) -> Move:
    """The same move with left and right exchanged."""

    def other(key: Key) -> Key:
        chest, head = ((-a[0], a[1], -a[2]) for a in (key.chest, key.head))
        return replace(key, left=key.right, right=key.left, chest=chest, head=head)

    return replace(move, keys=tuple(other(key) for key in move.keys))


def parse_keys(text: str) -> tuple[Key, ...]:
    """Parse keys, separated by `;`: count, pose (or left/right), then c: chest and h: head angles."""
    result = []
    for item in text.split(";"):
        count, pose, *rest = item.split()
        left, _, right = pose.partition("/")
        angles = {"c": (0.0, 0.0, 0.0), "h": (0.0, 0.0, 0.0)}
        for word in rest:
            yaw, pitch, roll = (float(number) for number in word[2:].split("/"))
            angles[word[0]] = (yaw, pitch, roll)
        result.append(Key(float(count), left, right or left, angles["c"], angles["h"]))
    return tuple(result)
