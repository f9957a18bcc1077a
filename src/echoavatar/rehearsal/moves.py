"""The vocabulary of arms, torso and head: moves of 2, 4 or 8 counts between named poses that arrive on counts.

Arm poses are wrists in mirrored chest axes from the shoulder joint (x outwards, y up, z forwards, metres) with the
hand that goes with them. Not from the paper, whose dance is recorded.
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
    "hang": ArmPose((0.125, -0.45, 0.08), (0.08, 0.0, 0.35)),
    "loose": ArmPose((0.10, -0.31, 0.22), (0.05, 0.0, 0.35), hand="loose_fist"),
    "guard": ArmPose((0.02, -0.16, 0.27), (0.0, 0.0, 0.3), hand="loose_fist"),
    "fore": ArmPose((0.02, -0.23, 0.33), (0.0, 0.0, 0.1), hand="loose_fist", shoulder=(0.0, 0.12)),
    "back": ArmPose((0.14, -0.37, -0.13), (0.1, 0.0, 0.3), hand="loose_fist", shoulder=(0.02, -0.12)),
    "chest": ArmPose((-0.05, -0.12, 0.27), (0.0, 0.0, 0.6), 0.25),
    "front": ArmPose((-0.02, -0.01, 0.45), (0.0, 0.0, 0.6), 0.1, (0.05, 0.15)),
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
    "hip": ArmPose((0.07, -0.33, 0.04), (0.5, 0.0, 0.6), 0.45, (0.02, 0.0), "relaxed"),
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
    """Poses reached on a count: both arms, the chest on the pelvis and the head's accent (yaw, pitch, roll)."""

    count: float
    left: str
    right: str
    chest: Triple = (0.0, 0.0, 0.0)
    head: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Move:
    """A pattern of keys; `travel` is how many counts a hit takes (less: sharper), `flow` rounds the stops away."""

    name: str
    counts: int
    keys: tuple[Key, ...]
    energy: tuple[float, float] = (0.0, 1.0)
    styles: tuple[str, ...] = ()
    travel: float = 0.8
    flow: float = 0.0
    exact: bool = False  # hands meet or touch: never scaled
    is_fixed: bool = False  # never mirrored


def mirrored(move: Move) -> Move:
    """The same move with left and right exchanged."""

    def other(key: Key) -> Key:
        chest, head = ((-a[0], a[1], -a[2]) for a in (key.chest, key.head))
        return replace(key, left=key.right, right=key.left, chest=chest, head=head)

    return replace(move, keys=tuple(other(key) for key in move.keys))


def _both(count: float, pose: str, chest: Triple = (0.0, 0.0, 0.0), head: Triple = (0.0, 0.0, 0.0)) -> Key:
    return Key(count, pose, pose, chest, head)


GROOVY = ("house", "hip_hop", "drum_and_bass", "rock", "swing", "salsa", "pop")
FLOWING = ("ballet", "ballad", "waltz", "rest")

MOVES: tuple[Move, ...] = (
    Move("arm_swing", 2, (Key(0, "back", "fore", (0.10, 0.03, 0.0)), Key(1, "fore", "back", (-0.10, 0.03, 0.0))),
         energy=(0.0, 0.8), styles=GROOVY, travel=1.0, flow=0.5),
    Move("loose_bounce", 4, (_both(0, "loose", (0.06, 0.05, 0.04)), _both(1, "guard", (0.0, 0.0, 0.0)), _both(2, "loose", (-0.06, 0.05, -0.04)), _both(3, "guard")),
         energy=(0.0, 0.5), styles=GROOVY, flow=0.4),
    Move("chest_pop", 4,
         (_both(0, "loose", (0.0, -0.20, 0.0), (0.0, 0.06, 0.0)), _both(0.5, "guard", (0.0, 0.12, 0.0)), _both(1, "loose", (0.0, -0.20, 0.0), (0.0, 0.06, 0.0)),
          _both(1.5, "guard", (0.0, 0.12, 0.0)), _both(2, "shrug", (0.12, -0.20, 0.0), (0.2, 0.0, 0.0)), _both(3, "unshrug", (-0.12, 0.10, 0.0), (-0.2, 0.1, 0.0))),
         energy=(0.3, 1.0), styles=("hip_hop", "house", "drum_and_bass", "pop"), travel=0.42),
    Move("body_roll", 4,
         (_both(0, "side_low", (0.0, -0.22, 0.0), (0.0, -0.12, 0.0)), _both(1, "loose", (0.0, -0.02, 0.0), (0.0, 0.05, 0.0)), _both(2, "hip", (0.0, 0.26, 0.0), (0.0, 0.18, 0.0)),
          _both(3, "loose", (0.0, 0.05, 0.0), (0.0, 0.0, 0.0))),
         energy=(0.2, 0.8), styles=("hip_hop", "house", "drum_and_bass", "salsa", "pop"), travel=1.0, flow=0.9),
    Move("arm_wave", 4,
         (Key(0, "wave_high", "wave_low", (0.0, 0.0, 0.10), (0.25, 0.0, 0.0)), Key(1, "wave_low", "side", (0.0, 0.0, 0.0)), Key(2, "wave_low", "wave_high", (0.0, 0.0, -0.10), (-0.25, 0.0, 0.0)),
          Key(3, "side", "wave_low", (0.0, 0.0, 0.0))),
         energy=(0.3, 0.9), styles=("hip_hop", "house", "drum_and_bass", "ballet", "ballad", "pop"), travel=1.0, flow=0.8),
    Move("raise", 4, (_both(0, "chest", (0.0, 0.06, 0.0)), _both(1, "vee", (0.0, -0.10, 0.0), (0.0, -0.12, 0.0)), _both(2, "side", (0.0, -0.04, 0.0)), _both(3, "loose", (0.0, 0.08, 0.0), (0.0, 0.08, 0.0))),
         energy=(0.5, 1.0), styles=GROOVY, travel=0.85),
    Move("clap", 4, (_both(0, "unclap", (0.10, 0.0, 0.05)), _both(1, "clap", (0.08, 0.08, 0.04), (0.0, 0.08, 0.0)), _both(2, "unclap", (-0.10, 0.0, -0.05)), _both(3, "clap", (-0.08, 0.08, -0.04), (0.0, 0.08, 0.0))),
         energy=(0.3, 1.0), styles=("house", "rock", "swing", "salsa", "pop", "hip_hop"), travel=0.6, exact=True),
    Move("high_clap", 4, (_both(0, "unclap", (0.0, 0.06, 0.0)), _both(1, "high_clap", (0.0, -0.06, 0.0), (0.0, -0.1, 0.0)), _both(2, "unclap", (0.0, 0.06, 0.0)), _both(3, "high_clap", (0.0, -0.06, 0.0), (0.0, -0.1, 0.0))),
         energy=(0.75, 1.0), styles=("house", "rock", "pop"), travel=0.75, exact=True),
    Move("punches", 4,
         (Key(0, "punch", "chamber", (-0.22, 0.05, 0.0)), Key(1, "chamber", "punch", (0.22, 0.05, 0.0)), Key(2, "punch", "chamber", (-0.22, 0.05, 0.0)), Key(2.5, "chamber", "chamber"),
          Key(3, "chamber", "punch", (0.24, 0.08, 0.0), (0.0, 0.08, 0.0))),
         energy=(0.6, 1.0), styles=("hip_hop", "drum_and_bass", "rock"), travel=0.5),
    Move("shimmy", 4,
         tuple(Key(c / 2, *(("shrug", "unshrug") if c % 2 == 0 else ("unshrug", "shrug")), (0.09 * (-1) ** c, 0.02 * (c // 2) - 0.04, 0.0)) for c in range(8)),
         energy=(0.4, 1.0), styles=("salsa", "house", "swing", "pop"), travel=0.5),
    Move("hand_circles", 2,
         (Key(0, "circle_top", "circle_low", (0.05, 0.03, 0.0)), Key(0.5, "circle_front", "circle_near"), Key(1, "circle_low", "circle_top", (-0.05, 0.03, 0.0)), Key(1.5, "circle_near", "circle_front")),
         energy=(0.4, 0.9), styles=("house", "swing", "rock", "pop", "salsa"), travel=0.5, flow=1.0, exact=True),
    Move("reach", 4,
         (Key(0, "vee", "hip", (0.14, 0.0, -0.12), (0.2, -0.15, 0.0)), Key(1, "chest", "chest", (0.0, 0.06, 0.0)), Key(2, "hip", "vee", (-0.14, 0.0, 0.12), (-0.2, -0.15, 0.0)), Key(3, "chest", "chest", (0.0, 0.06, 0.0))),
         energy=(0.5, 1.0), styles=GROOVY, travel=0.8),
    Move("cross_uncross", 4,
         (_both(0, "side", (0.0, -0.08, 0.0)), Key(1, "across", "across_low", (0.0, 0.12, 0.0), (0.0, 0.1, 0.0)), _both(2, "side", (0.0, -0.08, 0.0)), Key(3, "across_low", "across", (0.0, 0.12, 0.0), (0.0, 0.1, 0.0))),
         energy=(0.5, 1.0), styles=("house", "hip_hop", "rock", "drum_and_bass", "pop"), travel=0.75),
    Move("side_snap", 4,
         (Key(0, "snap_in", "snap_in", (0.0, 0.05, 0.0)), Key(1, "snap", "snap_in", (0.14, -0.02, -0.05), (0.25, 0.0, 0.08)), Key(2, "snap_in", "snap_in", (0.0, 0.05, 0.0)), Key(3, "snap_in", "snap", (-0.14, -0.02, 0.05), (-0.25, 0.0, -0.08))),
         energy=(0.15, 0.7), styles=("swing", "salsa", "rock", "pop", "house", "ballad"), travel=0.6),
    Move("salsa_elbows", 2, (Key(0, "salsa_back", "salsa_front", (0.14, 0.02, 0.05)), Key(1, "salsa_front", "salsa_back", (-0.14, 0.02, -0.05))),
         energy=(0.1, 1.0), styles=("salsa", "swing"), travel=0.9, flow=0.3),
    Move("roof", 2, (_both(0, "up_bent", (0.0, 0.08, 0.0), (0.0, 0.08, 0.0)), _both(0.5, "vee", (0.0, -0.06, 0.0)), _both(1, "up_bent", (0.0, 0.08, 0.0), (0.0, 0.08, 0.0)), _both(1.5, "vee", (0.0, -0.06, 0.0))),
         energy=(0.8, 1.0), styles=("house", "hip_hop", "drum_and_bass", "pop"), travel=0.5, flow=0.2),
    Move("disco", 4,
         (Key(0, "point_up", "hip", (0.16, -0.05, -0.08), (0.2, -0.1, 0.0)), Key(1, "point_down", "hip", (-0.18, 0.12, 0.05), (-0.1, 0.15, 0.0)), Key(2, "point_up", "hip", (0.16, -0.05, -0.08), (0.2, -0.1, 0.0)),
          Key(3, "point_down", "hip", (-0.18, 0.12, 0.05), (-0.1, 0.15, 0.0))),
         energy=(0.55, 1.0), styles=("house", "pop", "rock"), travel=0.8),
    Move("overhead_sway", 4,
         (Key(0, "sway_out", "sway_in", (0.0, 0.0, -0.12), (0.0, 0.0, -0.1)), Key(2, "sway_in", "sway_out", (0.0, 0.0, 0.12), (0.0, 0.0, 0.1))),
         energy=(0.5, 1.0), styles=("house", "rock", "pop", "drum_and_bass"), travel=1.8, flow=0.5),
    Move("push", 4,
         (Key(0, "push", "pull", (-0.14, 0.05, 0.0)), Key(1, "pull", "push", (0.14, 0.05, 0.0)), Key(2, "push", "push", (0.0, 0.10, 0.0), (0.0, 0.05, 0.0)), Key(3, "pull", "pull", (0.0, -0.08, 0.0))),
         energy=(0.4, 0.9), styles=("hip_hop", "drum_and_bass", "rock", "swing"), travel=0.6),
    Move("frame", 4,
         (Key(0, "frame_left", "frame_right", (0.08, -0.03, 0.07), (0.15, -0.03, 0.05)), Key(2, "frame_left", "frame_right", (-0.08, -0.03, -0.07), (0.15, -0.03, -0.05))),
         energy=(0.0, 1.0), styles=("waltz",), travel=2.0, flow=0.8, is_fixed=True),
    Move("open_arms", 4,
         (Key(0, "first", "first", (0.0, 0.06, 0.0), (0.0, 0.08, 0.0)), Key(1, "second", "second", (0.0, -0.06, 0.0), (0.0, -0.06, 0.0)), Key(2, "second", "second", (0.10, -0.05, -0.08), (0.2, 0.0, 0.0)), Key(3, "demi", "demi")),
         energy=(0.3, 1.0), styles=("waltz", "ballet", "ballad"), travel=1.4, flow=1.0),
    Move("port_de_bras", 8,
         (Key(0, "bras_bas", "bras_bas", (0.0, 0.08, 0.0), (0.0, 0.12, 0.0)), Key(2, "first", "first", (0.0, 0.0, 0.0), (0.1, 0.05, 0.0)), Key(4, "fifth", "second", (0.10, -0.10, -0.10), (-0.25, -0.12, 0.05)),
          Key(6, "second", "second", (0.0, -0.05, 0.0), (0.2, -0.05, 0.0)), Key(7, "demi", "demi", (0.0, 0.02, 0.0), (0.0, 0.05, 0.0))),
         energy=(0.2, 1.0), styles=("ballet",), travel=2.0, flow=1.0),
    Move("arabesque_arms", 8,
         (Key(0, "first", "bras_bas", (0.05, 0.04, 0.0), (0.1, 0.05, 0.0)), Key(2, "reach", "second", (-0.12, -0.02, 0.06), (0.1, -0.06, 0.0)), Key(4, "second", "first", (0.12, 0.0, -0.05), (0.2, 0.0, 0.0)),
          Key(6, "second", "reach", (0.12, -0.02, -0.06), (-0.1, -0.06, 0.0)), Key(7.5, "demi", "demi"))  ,
         energy=(0.0, 1.0), styles=("ballet",), travel=2.0, flow=1.0),
    Move("soft_sway", 8,
         (Key(0, "demi", "bras_bas", (0.06, 0.03, 0.06), (0.08, 0.04, 0.04)), Key(4, "bras_bas", "demi", (-0.06, 0.03, -0.06), (-0.08, 0.04, -0.04))),
         energy=(0.0, 0.5), styles=FLOWING, travel=4.0, flow=1.0),
    Move("hips", 4, (_both(0, "hip", (0.0, 0.0, 0.08), (0.1, 0.05, 0.0)), _both(1, "hip", (0.0, 0.02, -0.08), (-0.1, 0.05, 0.0)), _both(2, "hip", (0.0, 0.0, 0.08), (0.1, 0.05, 0.0)), _both(3, "hip", (0.0, 0.02, -0.08), (-0.1, 0.05, 0.0))),
         energy=(0.1, 0.6), styles=("salsa", "rock", "pop", "hip_hop"), travel=0.8, exact=True),
)  # fmt: skip
MOVE = {move.name: move for move in MOVES}


def fitting(style: str, energy: float) -> list[Move]:
    """The moves a style and an energy allow; never empty."""
    kind = [move for move in MOVES if not move.styles or style in move.styles]
    near = [move for move in kind if move.energy[0] <= energy <= move.energy[1]]
    if near:
        return near
    return [min(kind or list(MOVES), key=lambda m: abs(energy - (m.energy[0] + m.energy[1]) / 2))]
