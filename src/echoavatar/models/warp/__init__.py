"""The model behind the beat-aligned time warp: from streaming sound, a curve of 0 to 1 that says when to brake.

It hears stressed syllables and beats. Not in the paper, whose generator keeps time by itself. May import `face` (its
mel encoder), `audio`, `data`, `training` (only `train`), `nn`, `checkpoint` and below.
"""

from .config import WarpConfig
from .model import WarpModel, WarpModelState

__all__ = ["WarpConfig", "WarpModel", "WarpModelState"]
