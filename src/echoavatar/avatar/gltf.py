"""Our own glTF 2.0 binary writer: the skinned character with one or more animations, by struct and json alone.

Node names are the VRM 1.0 humanoid bone names; the face's morph targets have the ARKit names. The mesh nodes stay
outside the joint hierarchy, inverse bind matrices are column-major, COLOR_0 is linear.
"""

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..errors import MotionError
from ..kinematics import HUMANOID
from .character import Character
from .gltf_buffer import Buffer
from .gltf_mesh import materials, meshes
from .morphs import checked_face

BODY_NODE = HUMANOID.joints
FACE_NODE = HUMANOID.joints + 1


class Animation(NamedTuple):
    """Motion to embed: parent-relative quaternions `wxyz`, the hips' world position in metres, and the face."""

    name: str
    rotations: Float[np.ndarray, "t j 4"]
    root: Float[np.ndarray, "t 3"]
    fps: float = 30.0
    face: Float[np.ndarray, "t n"] | None = None  # weights 0..1 of the character's blendshapes


def write_glb(
    path: str | Path,
    character: Character,
    rotations: Float[np.ndarray, "t j 4"],
    root: Float[np.ndarray, "t 3"],
    fps: float = 30.0,
    name: str = "motion",
    face: Float[np.ndarray, "t n"] | None = None,
) -> None:
    """Write the character with one animation; raises `MotionError` for motion that is not finite or of another rig."""
    curves = None if face is None else np.asarray(face)
    animation = Animation(name, np.asarray(rotations), np.asarray(root), fps, curves)
    write_whole(Path(path), pack_glb(character, [animation]))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file complete or not at all."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        raise MotionError(f"cannot write {path} ({error.strerror}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)


def pack_glb(character: Character, animations: Sequence[Animation], *, compact: bool = False) -> bytes:
    """The GLB's bytes; `compact` stores rotations as 16-bit integers (error below 0.01 degrees)."""
    buffer = Buffer()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "EchoAvatar"},
        "scene": 0,
        "scenes": [{"name": "EchoAvatar", "nodes": [0, BODY_NODE, FACE_NODE]}],
        "nodes": [
            *_joint_nodes(),
            {"name": "body", "mesh": 0, "skin": 0},
            {"name": "face", "mesh": 1, "skin": 0},
        ],
        "materials": materials(),
        "meshes": meshes(buffer, character),
        "skins": [_skin(buffer)],
    }  # fmt: skip
    if animations:
        document["animations"] = [_animation(buffer, animation, compact=compact) for animation in animations]
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    return container(document, bytes(buffer.data))


def _joint_nodes() -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": [round(float(x), 6) for x in offset]}
        for name, offset in zip(HUMANOID.names, HUMANOID.config.offsets, strict=True)
    ]
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
    return nodes


def _skin(buffer: Buffer) -> dict[str, Any]:
    """Column-major inverse bind matrices: the rest pose has no rotations, so each undoes one translation."""
    matrices = np.tile(np.eye(4, dtype=np.float32), (HUMANOID.joints, 1, 1))
    matrices[:, 3, :3] = -HUMANOID.rest_positions.numpy()
    joints = list(range(HUMANOID.joints))
    return {"name": "humanoid", "inverseBindMatrices": buffer.add(matrices), "joints": joints, "skeleton": 0}


def _animation(buffer: Buffer, animation: Animation, *, compact: bool) -> dict[str, Any]:
    """Linear tracks: one rotation per joint, one translation of the hips, one of all the face's weights."""
    rotations, root = checked(animation.rotations, animation.root)
    times = (np.arange(len(root)) / animation.fps).astype(np.float32)
    clock = buffer.add(times, bounds=True)
    xyzw = continuous(rotations)[..., [1, 2, 3, 0]]
    samplers = [{"input": clock, "interpolation": "LINEAR", "output": buffer.add(root.astype(np.float32))}]
    channels: list[dict[str, Any]] = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    for joint in range(HUMANOID.joints):
        track = xyzw[:, joint]
        stored = np.round(track * 32767).astype(np.int16) if compact else track.astype(np.float32)
        channels.append({"sampler": len(samplers), "target": {"node": joint, "path": "rotation"}})
        samplers.append(
            {"input": clock, "interpolation": "LINEAR", "output": buffer.add(stored, normalized=compact)}
        )
    if animation.face is not None:
        weights = checked_face(animation.face, len(root)).reshape(-1)
        curves = np.round(weights * 255).astype(np.uint8) if compact else weights
        channels.append({"sampler": len(samplers), "target": {"node": FACE_NODE, "path": "weights"}})
        samplers.append(
            {"input": clock, "interpolation": "LINEAR", "output": buffer.add(curves, normalized=compact)}
        )
    return {"name": animation.name, "samplers": samplers, "channels": channels}


def checked(
    rotations: ArrayLike, root: ArrayLike
) -> tuple[Float[np.ndarray, "t j 4"], Float[np.ndarray, "t 3"]]:
    """Unit quaternions and root as float64; raises `MotionError` when they do not fit our rig."""
    q, p = np.asarray(rotations, np.float64), np.asarray(root, np.float64)
    if q.ndim != 3 or q.shape[1:] != (HUMANOID.joints, 4) or p.shape != (len(q), 3) or not len(q):
        raise MotionError(
            f"motion has shapes {q.shape} and {p.shape}; the character takes (t, {HUMANOID.joints}, 4) "
            "and (t, 3): retarget it first"
        )
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (np.isfinite(q).all() and np.isfinite(p).all() and (length > 1e-6).all()):
        raise MotionError(
            "motion holds values that are not finite or quaternions of length 0; repair it before export"
        )
    return q / length, p


def continuous(q: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
    """Signs chosen so that neighbouring frames lie on the same half of the sphere."""
    flips = np.where(np.einsum("tji,tji->tj", q[1:], q[:-1]) < 0, -1.0, 1.0)
    signs = np.concatenate([np.ones((1, q.shape[1])), np.cumprod(flips, axis=0)])
    steady: Float[np.ndarray, "t j 4"] = q * signs[..., None]
    return steady


def container(document: dict[str, Any], binary: bytes) -> bytes:
    """A GLB's bytes from its JSON and its buffer (a multiple of four bytes)."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total)
    return (
        head
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )
