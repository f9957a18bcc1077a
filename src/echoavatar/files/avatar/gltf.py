"""Write binary glTF 2.0: our skinned character with one or more animations.

Nodes have the names of the VRM 1.0 humanoid bones, morph targets those of the ARKit curves. The mesh nodes are outside
the joint hierarchy, inverse bind matrices are column-major, and COLOR_0 is linear.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.resample import align_signs

from .character import Character
from .gltf_buffer import Buffer, Tracks
from .gltf_mesh import materials, meshes, pictures
from .halfway import BONES, PARENTS, REST, SOURCES, half
from .morphs import checked_face

BODY_NODE = HUMANOID.joints
FACE_NODE = HUMANOID.joints + 1
HALFWAY_NODES = tuple(range(FACE_NODE + 1, FACE_NODE + 1 + len(SOURCES)))


class GltfAnimation(NamedTuple):
    """Motion to embed: parent-relative quaternions `wxyz`, the world position of the hips, and the face."""

    name: str
    rotations: Float[np.ndarray, "t j 4"]
    root: Float[np.ndarray, "t 3"]
    fps: float = 30.0
    face: Float[np.ndarray, "t n"] | None = None  # blendshape weights 0..1


def pack_glb(character: Character, animations: Sequence[GltfAnimation], *, compact: bool = False) -> bytes:
    """The GLB's bytes; `compact` stores rotations as 16-bit integers (error below 0.01 degrees)."""
    document, buffer = character_document(character)
    if animations:
        document["animations"] = [_animation(buffer, animation, compact=compact) for animation in animations]
    return packed(document, buffer)


def character_document(character: Character) -> tuple[dict[str, Any], Buffer]:
    """The character's document, to which more may be added before `packed`, and its buffer."""
    buffer = Buffer()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "EchoAvatar"},
        "scene": 0,
        "scenes": [{"name": "EchoAvatar", "nodes": [0, BODY_NODE, FACE_NODE]}],
        "nodes": _nodes(),
        "materials": materials(character.textures),
        "meshes": meshes(buffer, character),
        **pictures(buffer, character),
        "skins": [_skin(buffer)],
    }  # fmt: skip
    return document, buffer


def packed(document: dict[str, Any], buffer: Buffer) -> bytes:
    """The bytes of a GLB with all that was collected in the buffer."""
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    return container(document, bytes(buffer.data))


def _nodes() -> list[dict[str, Any]]:
    """The joints, the meshes, and the halfway bones, which hang on the parents of their bones."""
    places = [[round(float(x), 6) for x in offset] for offset in HUMANOID.config.offsets]
    nodes: list[dict[str, Any]] = [
        *({"name": name, "translation": place} for name, place in zip(HUMANOID.names, places, strict=True)),
        {"name": "body", "mesh": 0, "skin": 0},
        {"name": "face", "mesh": 1, "skin": 0},
        *({"name": BONES[HUMANOID.joints + i], "translation": places[joint]} for i, joint in enumerate(SOURCES)),
    ]
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
    for node, parent in zip(HALFWAY_NODES, PARENTS, strict=True):
        nodes[parent]["children"].append(node)
    return nodes


def _skin(buffer: Buffer) -> dict[str, Any]:
    """The skin. The rest pose has no rotations, so each inverse bind matrix (column-major) undoes one translation."""
    matrices = np.tile(np.eye(4, dtype=np.float32), (len(BONES), 1, 1))
    matrices[:, 3, :3] = -REST
    joints = [*range(HUMANOID.joints), *HALFWAY_NODES]
    return {"name": "humanoid", "inverseBindMatrices": buffer.add(matrices), "joints": joints, "skeleton": 0}


def _animation(buffer: Buffer, animation: GltfAnimation, *, compact: bool) -> dict[str, Any]:
    """Tracks of the animation: a rotation per bone, the translation of the hips, the face's weights."""
    rotations, root = checked(animation.rotations, animation.root)
    tracks = Tracks(buffer, len(root), animation.fps)
    tracks.add(0, "translation", root)
    halves = half(rotations[:, list(SOURCES)])
    xyzw = align_signs(np.concatenate([rotations, halves], 1))[..., [1, 2, 3, 0]]
    for bone, node in enumerate((*range(HUMANOID.joints), *HALFWAY_NODES)):
        track = xyzw[:, bone]
        tracks.add(node, "rotation", np.round(track * 32767).astype(np.int16) if compact else track)
    if animation.face is not None:
        weights = checked_face(animation.face, len(root)).reshape(-1)
        tracks.add(FACE_NODE, "weights", np.round(weights * 255).astype(np.uint8) if compact else weights)
    return {"name": animation.name, "samplers": tracks.samplers, "channels": tracks.channels}


def checked(rotations: ArrayLike, root: ArrayLike) -> tuple[Float[np.ndarray, "t j 4"], Float[np.ndarray, "t 3"]]:
    """Unit quaternions and root as float64; raises MotionError where they do not fit our rig."""
    q, p = np.asarray(rotations, np.float64), np.asarray(root, np.float64)
    if q.ndim != 3 or q.shape[1:] != (HUMANOID.joints, 4) or p.shape != (len(q), 3) or not len(q):
        raise MotionError(
            f"motion has shapes {q.shape} and {p.shape}; the character takes (t, {HUMANOID.joints}, 4) "
            "and (t, 3): retarget it first"
        )
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (np.isfinite(q).all() and np.isfinite(p).all() and (length > 1e-6).all()):
        raise MotionError("motion holds values that are not finite or quaternions of length 0; repair it before export")
    return q / length, p


def container(document: dict[str, Any], binary: bytes) -> bytes:
    """The bytes of a GLB with this JSON and this buffer, whose length is a multiple of four."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total)
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
