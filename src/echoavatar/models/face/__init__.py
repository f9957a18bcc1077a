"""Faces: 52 ARKit curves from sound, streaming (paper, Facial Animation and Face Animation Generator).

The model is trained in echoavatar-lab. Here its audio encoder (the ear) is an ONNX graph, and a compiled loop makes the
frames. May import `audio`, `models.noise`, `nn` and below.
"""

from .config import FaceConfig, HubertConfig, MelConfig
from .stream import FaceState, FaceStream

__all__ = ["FaceConfig", "FaceState", "FaceStream", "HubertConfig", "MelConfig"]
