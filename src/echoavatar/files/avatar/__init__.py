"""The visible avatar: our own character, its skinning, and the files, films and pages that show it.

May import `kinematics` and below. Metres, Y up, facing +Z, quaternions `wxyz`; colours sRGB.
"""

from .character import MATERIALS, Character, Material, load_character
from .skinning import skin

__all__ = ["MATERIALS", "Character", "Material", "load_character", "skin"]
