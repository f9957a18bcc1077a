"""Write motion for other programs (VRMA, USD, FBX, SMPL-X, ...) and retarget it to the user's character (`--rig`).

May import `files.avatar`, `models`, `motion` and below.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from .formats import SUFFIXES, check_output, write_take
from .take import Take, read_take

if TYPE_CHECKING:
    from .target_rig import Rig, read_rig

__all__ = ["SUFFIXES", "Rig", "Take", "check_output", "read_rig", "read_take", "write_take"]


def __getattr__(name: str) -> object:
    """Import rigs when they are first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(".target_rig", __name__), name)
