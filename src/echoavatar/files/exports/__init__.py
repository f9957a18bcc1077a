"""Write motion for other programs (VRMA, USD, FBX, SMPL-X, ...) and retarget it to the user's character (`--rig`).

May import `engine`, `unity`, `datasets`, `avatar`, `ik`, `face` and below.
"""

from .formats import FORMATS, writer
from .take import Take, read_take
from .target_rig import Rig, read_rig

__all__ = ["FORMATS", "Rig", "Take", "read_rig", "read_take", "writer"]
