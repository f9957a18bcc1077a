"""The warp model: from streaming sound, a brake curve of 0 to 1 for the beat-aligned time warp.

It detects stressed syllables and beats. Not in the paper, whose generator keeps time by itself. May import
`models.face` (its mel encoder), `models.audio`, `data`, `training`, and `nn` and below.
"""

from .config import WarpConfig
from .model import WarpModel, WarpModelState

__all__ = ["WarpConfig", "WarpModel", "WarpModelState"]
