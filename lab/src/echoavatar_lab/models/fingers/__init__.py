"""Fingers for motion without them (paper, Motion Refinement): an inpainting model of the hands given the body.

May import `training`, `nn`, `checkpoint` and `echoavatar`.
"""

from .model import FingerConfig, FingerModel, load_shipped
from .refine import frozen_hands, refine_fingers

__all__ = ["FingerConfig", "FingerModel", "frozen_hands", "load_shipped", "refine_fingers"]
