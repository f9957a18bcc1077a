"""Faces: 52 ARKit curves from sound, streaming (paper, Facial Animation and Face Animation Generator).

May import `generator` (the hash of its noise), `audio`, `nn`, `checkpoint` and below.
"""

from .config import FaceConfig, HubertConfig, MelConfig
from .model import FaceModel
from .stream import FaceState, FaceStream

__all__ = ["FaceConfig", "FaceModel", "FaceState", "FaceStream", "HubertConfig", "MelConfig"]
