"""VMC, the protocol of VTuber programs (VSeeFace, Warudo, Unity, Unreal, Blender): bones and expressions over OSC.

We are the performer; the program with the avatar listens, by default on port 39539. Positions and rotations are in
Unity's left-handed axes. Bones have Unity's names, which place thumb names one bone further out than VRM 1.0 does.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES, to_vrm
from echoavatar.wire import Rig

from .osc import Bundles, Message
from .sink import Frame

Names = Literal["vrm0", "vrm1", "arkit", "perfect"]
NAMES = get_args(Names)
_VRM0 = (
    "A", "I", "U", "E", "O", "Blink", "Blink_L", "Blink_R", "LookUp", "LookDown", "LookLeft", "LookRight",
)  # fmt: skip
_THUMBS = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}
_ROOT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def unity_bone(name: str) -> str:
    """Unity's name of a VRM 1.0 bone."""
    for vrm_name, unity_name in _THUMBS.items():
        if name.endswith(vrm_name):
            name = name.removesuffix(vrm_name) + unity_name
            break
    return name[:1].upper() + name[1:]


def expression_names(names: Names) -> tuple[str, ...]:
    """Names of the expressions: VRM 0.x or 1.0 presets, or all 52 ARKit shapes (capitalised for "perfect sync")."""
    return {
        "vrm0": _VRM0,
        "vrm1": VRM_NAMES,
        "arkit": ARKIT_NAMES,
        "perfect": tuple(name[:1].upper() + name[1:] for name in ARKIT_NAMES),
    }[names]


def to_unity(rotations: Float[np.ndarray, "j 4"], places: Float[np.ndarray, "j 3"]) -> Float[np.ndarray, "j 7"]:
    """Position and rotation (xyzw) of each bone in Unity's mirrored axes."""
    w, x, y, z = rotations.T
    return np.stack([-places[:, 0], places[:, 1], places[:, 2], x, -y, -z, w], 1)


class VmcEncoder:
    """Encodes frames as VMC bundles."""

    def __init__(self, rig: Rig, names: Names = "vrm0") -> None:
        expressions = expression_names(names)
        self._is_preset = names in ("vrm0", "vrm1")
        self._at_rest = np.zeros(len(expressions))
        self._rest = np.array(rig.rest, np.float64)
        bones = [Message("/VMC/Ext/Bone/Pos", unity_bone(name), 7) for name in rig.names]
        blends = [Message("/VMC/Ext/Blend/Val", name, 1) for name in expressions]
        self._bundles = Bundles(
            [
                Message("/VMC/Ext/OK", 1, 0),
                Message("/VMC/Ext/T", None, 1),
                Message("/VMC/Ext/Root/Pos", "root", 7),
                *bones,
                *blends,
                Message("/VMC/Ext/Blend/Apply", None, 0),
            ]
        )

    def faces(self, curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t n"]:
        """Weights of the expressions."""
        return to_vrm(curves) if self._is_preset else curves

    def __call__(self, frame: Frame) -> list[bytearray]:
        """The bundles of a frame; the next frame reuses their buffers."""
        places = self._rest.copy()
        places[0] = frame.root
        parts = [np.array([frame.seconds, *_ROOT]), to_unity(frame.rotations, places).ravel()]
        parts.append(self._at_rest if frame.face is None else frame.face)
        return self._bundles.fill(np.concatenate(parts))
