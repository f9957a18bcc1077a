"""Motion into files of other programs, and onto other characters: VRMA, USD, FBX, SMPL-X, and `--rig`.

May import `engine`, `unity`, `datasets`, `avatar`, `ik`, `face` and below.
"""

from .formats import FORMATS, writer
from .take import Take, read_take
from .target_rig import Rig, read_rig

__all__ = ["FORMATS", "Rig", "Take", "read_rig", "read_take", "writer"]
