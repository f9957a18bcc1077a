"""Closed-form inverse kinematics of legs and arms, hands kept off the body, and the body's measures.

May import `motion.kinematics`, and `nn` and below. Poses are in the root's frame: where the character stands does not
matter. Metres, radians, Y up in the rest pose, character facing +Z.
"""

from .cylinder import Cylinder
from .fit import measure_body
from .hand_collisions import HandCollisions
from .measure import penetration_depth_m
from .profile import BodyProfile, RoundedPart, body_of_rig
from .swing import SwingConfig, swing_clear

__all__ = [
    "BodyProfile",
    "Cylinder",
    "HandCollisions",
    "RoundedPart",
    "SwingConfig",
    "body_of_rig",
    "measure_body",
    "penetration_depth_m",
    "swing_clear",
]
