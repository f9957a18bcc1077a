"""Closed-form inverse kinematics of legs and arms, hands kept off the body, and the body's measures.

May import `motion.kinematics`, and `nn` and below. Poses are in the root's frame: where the character stands does not
matter. Metres, radians, Y up in the rest pose, character facing +Z.
"""

from .cylinder import Cylinder, SwingConfig, swing_clear
from .hand_collisions import HandCollisions
from .profile import BodyProfile, RoundedPart, body_of_rig, measure_body

__all__ = [
    "BodyProfile",
    "Cylinder",
    "HandCollisions",
    "RoundedPart",
    "SwingConfig",
    "body_of_rig",
    "measure_body",
    "swing_clear",
]
