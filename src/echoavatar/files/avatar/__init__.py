"""The visible avatar: our own character, its skinning, and the files, films and pages that show it.

May import `motion` and below. Metres, Y up, facing +Z, quaternions `wxyz`; colours sRGB.
"""

from .character import CHARACTERS, LEVELS, MATERIALS, Character, Material, Textures, level_file, load_character
from .skinning import skin

__all__ = [
    "CHARACTERS",
    "LEVELS",
    "MATERIALS",
    "Character",
    "Material",
    "Textures",
    "level_file",
    "load_character",
    "skin",
]
