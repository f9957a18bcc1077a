"""Faces: 52 ARKit curves from sound, streaming (paper, Facial Animation and Face Animation Generator).

May import `audio`, `models.noise`, `nn`, `checkpoint` and below.
"""

from typing import TYPE_CHECKING, Any

from .config import FaceConfig, HubertConfig, MelConfig
from .stream import FaceState, FaceStream, FrozenFace

if TYPE_CHECKING:
    from .model import FaceModel

__all__ = ["FaceConfig", "FaceModel", "FaceState", "FaceStream", "FrozenFace", "HubertConfig", "MelConfig"]


def __getattr__(name: str) -> Any:
    """Import the model when it is first asked for, because it needs torch."""
    if name != "FaceModel":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .model import FaceModel

    return FaceModel
