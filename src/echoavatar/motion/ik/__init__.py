"""Hands kept off the body by closed-form inverse kinematics, and the body's thickness they are kept off.

May import `kinematics` and below. Poses are in the root's frame here: where the character stands does not matter.
Metres, radians, Y up in the rest pose, character facing +Z.
"""

from .fit import measure_body
from .hand_collisions import HandCollisions
from .measure import penetration_depth_m
from .profile import BodyProfile, RoundedPart, body_of_rig
from .swing import SwingConfig, swing_clear

__all__ = [
    "BodyProfile",
    "HandCollisions",
    "RoundedPart",
    "SwingConfig",
    "body_of_rig",
    "measure_body",
    "penetration_depth_m",
    "swing_clear",
]
