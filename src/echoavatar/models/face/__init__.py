"""Faces: 52 ARKit curves from sound, streaming (paper, Facial Animation and Face Animation Generator).

The model is trained in the lab. Here its ear is a graph, and its frames are a compiled loop. May import `audio`,
`models.noise`, `nn` and below.
"""

from .config import FaceConfig, HubertConfig, MelConfig
from .stream import FaceState, FaceStream

__all__ = ["FaceConfig", "FaceState", "FaceStream", "HubertConfig", "MelConfig"]
