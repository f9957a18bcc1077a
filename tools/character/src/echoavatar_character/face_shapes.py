"""The 52 ARKit blendshapes of our character: displacements and turned normals of its neutral face.

The names and their order are data of the character; they equal `echoavatar.models.face.ARKIT_NAMES`.
Left is the character's left, +X.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from . import face_eyes as eyes
from . import face_mouth as mouth
from .face_points import FacePoints, Moves, total

Shape = Callable[[FacePoints], Moves]

_SIDED: dict[str, Shape] = {
    "eyeBlink": eyes.blink,
    "eyeLookDown": lambda f: eyes.look(f, up=-1),
    "eyeLookIn": lambda f: eyes.look(f, out=-1),
    "eyeLookOut": lambda f: eyes.look(f, out=1),
    "eyeLookUp": lambda f: eyes.look(f, up=1),
    "eyeSquint": eyes.squint,
    "eyeWide": eyes.wide,
    "jaw": mouth.jaw_left,
    "mouth": mouth.mouth_left,
    "mouthSmile": mouth.smile,
    "mouthFrown": mouth.frown,
    "mouthDimple": mouth.dimple,
    "mouthStretch": mouth.stretch,
    "mouthPress": mouth.press,
    "mouthLowerDown": mouth.lower_down,
    "mouthUpperUp": mouth.upper_up,
    "browDown": eyes.brow_down,
    "browOuterUp": eyes.brow_outer_up,
    "cheekSquint": eyes.cheek_squint,
    "noseSneer": mouth.nose_sneer,
}
_WHOLE: dict[str, Shape] = {
    "jawForward": mouth.jaw_forward,
    "jawOpen": mouth.jaw_open,
    "mouthClose": mouth.mouth_close,
    "mouthFunnel": mouth.funnel,
    "mouthPucker": mouth.pucker,
    "mouthRollLower": mouth.roll_lower,
    "mouthRollUpper": mouth.roll_upper,
    "mouthShrugLower": mouth.shrug_lower,
    "mouthShrugUpper": mouth.shrug_upper,
    "browInnerUp": lambda f: total(eyes.brow_inner_up(f), _other_side(eyes.brow_inner_up, f)),
    "cheekPuff": mouth.cheek_puff,
    "tongueOut": mouth.tongue_out,
}
FACE_NAMES: tuple[str, ...] = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft",
    "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight",
    "eyeSquintRight", "eyeWideRight", "jawForward", "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel",
    "mouthPucker", "mouthRight", "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft",
    "mouthFrownRight", "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight",
    "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft",
    "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft",
    "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip


def displacement(name: str, f: FacePoints) -> Moves:
    """Displacements of the points by the shape `name` at 1."""
    if name in _WHOLE:
        return _WHOLE[name](f)
    stem, is_left = name.removesuffix("Left").removesuffix("Right"), name.endswith("Left")
    return _SIDED[stem](f) if is_left else _other_side(_SIDED[stem], f)


def turned_normals(
    name: str, f: FacePoints, normals: Float[np.ndarray, "n 3"], step: float = 2e-4
) -> Float[np.ndarray, "n 3"]:
    """Unit normals under the shape at 1, by the cofactors of the derivative of the displacement map."""

    def shaped(offset: np.ndarray) -> np.ndarray:
        at = f.at + offset
        moved: np.ndarray = at + displacement(name, f._replace(at=at))
        return moved

    columns = [(shaped(step * axis) - shaped(-step * axis)) / (2 * step) for axis in np.eye(3)]
    x, y, z = columns
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    turned = np.einsum("nij,nj->ni", cofactors, normals)
    unit: Float[np.ndarray, "n 3"] = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
    return unit


def _other_side(shape: Shape, f: FacePoints) -> Moves:
    mirrored: Moves = shape(f.mirrored()) * [-1, 1, 1]
    return mirrored
