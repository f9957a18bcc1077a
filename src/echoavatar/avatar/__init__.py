"""The avatar people see: our own character, its skin, and the files and pages that show it.

May import `kinematics` and below. Metres, Y up, facing +Z, quaternions `wxyz`; colours sRGB.
"""

from .character import MATERIALS, Character, Material, load_character
from .skinning import skin

__all__ = ["MATERIALS", "Character", "Material", "load_character", "skin"]
