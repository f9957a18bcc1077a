"""Write motion for other programs (VRMA, USD, FBX, SMPL-X, ...) and retarget it to the user's character (`--rig`).

May import `files.avatar`, `models`, `motion` and below.
"""

from .formats import SUFFIXES, check_output, write_take
from .take import Take, read_take
from .target_rig import Rig, read_rig

__all__ = ["SUFFIXES", "Rig", "Take", "check_output", "read_rig", "read_take", "write_take"]
