"""Write binary glTF 2.0: our skinned character with one or more animations.

Nodes have the names of the VRM 1.0 humanoid bones, morph targets those of the ARKit curves. The mesh nodes are outside
the joint hierarchy, inverse bind matrices are column-major, and COLOR_0 is linear. The face is a mesh of its own, so
that only its vertices have morph targets (sparse ones). Each material of the face has its own vertices.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy.typing import ArrayLike

from echoavatar.errors import MotionError
from echoavatar.motion.formats.gltf_data import TYPES
from echoavatar.motion.kinematics import HUMANOID, Skeleton
from echoavatar.motion.kinematics.motion import align_signs

from .character import MATERIALS, Character, Textures, checked_face, outfit_picture
from .halfway import BONES, PARENTS, REST, SOURCES, half

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
COMPONENT = {np.dtype(kind).name: code for code, kind in TYPES.items()}
SHAPE = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class Buffer:
    """The bytes collected so far, with their views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self, values: np.ndarray, *, target: int | None = None, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append one array as view and accessor; return the accessor's index."""
        values = np.ascontiguousarray(values)
        accessor: dict[str, Any] = {
            "bufferView": self.view(values, target=target),
            "componentType": COMPONENT[values.dtype.name],
            "count": len(values),
            "type": SHAPE[values.shape[1:]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": np.atleast_1d(values.min(0)).tolist(), "max": np.atleast_1d(values.max(0)).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def view(self, values: np.ndarray, *, target: int | None = None) -> int:
        """Append one array as a view; return the view's index."""
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        self.data += np.ascontiguousarray(values).tobytes()
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append(view)
        return len(self.views) - 1

    def sparse(self, count: int, indices: int, values: Float[np.ndarray, "m 3"], *, bounds: bool = False) -> int:
        """Add an accessor of `count` vectors: `values` at the places in the view `indices` (16 bit), 0 elsewhere."""
        accessor: dict[str, Any] = {"componentType": COMPONENT["float32"], "count": count, "type": "VEC3"}
        if len(values):
            places = {"bufferView": indices, "componentType": COMPONENT["uint16"]}
            filled = {"bufferView": self.view(values.astype(np.float32))}
            accessor["sparse"] = {"count": len(values), "indices": places, "values": filled}
        if bounds:
            extremes = values.astype(np.float32)
            if len(values) < count:
                extremes = np.concatenate([extremes, np.zeros((1, 3), np.float32)])
            accessor |= {"min": extremes.min(0).tolist(), "max": extremes.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


class Tracks:
    """Samplers and channels of one animation, on one clock."""

    def __init__(self, buffer: Buffer, frames: int, fps: float) -> None:
        self.buffer = buffer
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self._clock = buffer.add((np.arange(frames) / fps).astype(np.float32), bounds=True)

    def add(self, node: int, path: str, values: np.ndarray) -> None:
        """Animate a node's rotation (xyzw), translation or weights; integers are stored as they are, normalised."""
        is_float = values.dtype.kind == "f"
        stored = values.astype(np.float32) if is_float else values
        self.channels.append({"sampler": len(self.samplers), "target": {"node": node, "path": path}})
        output = self.buffer.add(stored, normalized=not is_float)
        self.samplers.append({"input": self._clock, "interpolation": "LINEAR", "output": output})


PLACE_STEP, MOVE_STEP, NORMAL_STEP, TURN_STEP = 2.0**-14, 2.0**-14, 2.0**-7, 2.0**-5  # metres or parts of 1


def meshes(buffer: Buffer, character: Character) -> list[dict[str, Any]]:
    """The meshes of body and face, in this order."""
    on_face = character.triangles[:, 0] < character.face.reach
    body = _primitives(buffer, character, character.triangles[~on_face])
    names = list(character.face.names)
    face = {
        "name": "face",
        "primitives": _face_primitives(buffer, character, character.triangles[on_face]),
        "weights": [0] * len(names),
        "extras": {"targetNames": names},
    }
    return [{"name": "body", "primitives": body}, face]


def materials(character: Character) -> list[dict[str, Any]]:
    """The glTF form of `MATERIALS`, then the clothes' materials in each further outfit; vertex colours are factors."""
    index = {name: i for i, name in enumerate(_present(character.textures))}
    made = []
    for material in MATERIALS:
        surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": material.roughness}
        entry: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": surface}
        if material.picture:
            surface["baseColorTexture"] = {"index": index[material.picture]}
        if material.roughness_picture in index:
            surface |= {"metallicRoughnessTexture": {"index": index[material.roughness_picture]}, "roughnessFactor": 1}
        if material.relief in index:
            entry["normalTexture"] = {"index": index[material.relief]}
            if material.repeats != (1, 1):
                entry["normalTexture"]["extensions"] = {TRANSFORM: {"scale": material.repeats}}
        if material.is_two_sided:
            entry["doubleSided"] = True
        if material.is_cutout:
            entry |= {"alphaMode": "MASK", "alphaCutoff": 0.5}
        made.append(entry)
    for number, outfit in enumerate(character.outfits[1:], 1):
        for entry in (made[i] for i in CLOTHES):
            surface = entry["pbrMetallicRoughness"] | {"baseColorTexture": {"index": index[outfit_picture(number)]}}
            made.append(entry | {"name": f"{entry['name']} {outfit}", "pbrMetallicRoughness": surface})
    return made


CLOTHES = tuple(i for i, material in enumerate(MATERIALS) if material.picture == "outfit")


def _variants(character: Character, material: int) -> dict[str, Any]:
    """The primitive's `KHR_materials_variants`: its material in each outfit; empty unless it is clothes."""
    if material not in CLOTHES or len(character.outfits) < 2:
        return {}
    place, step = len(MATERIALS) + CLOTHES.index(material), len(CLOTHES)
    chosen = [material, *(place + i * step for i in range(len(character.outfits) - 1))]
    mappings = [{"material": each, "variants": [i]} for i, each in enumerate(chosen)]
    return {"extensions": {VARIANTS: {"mappings": mappings}}}


def _present(textures: Textures) -> list[str]:
    """The names of the pictures that are not left out."""
    return [name for name, encoded in textures.items() if encoded]


def pictures(buffer: Buffer, character: Character) -> dict[str, list[dict[str, Any]]]:
    """The images, samplers and textures of a document."""
    images, names = [], _present(character.textures)
    for name in names:
        encoded = character.textures[name]
        kind = "image/png" if encoded[:4] == b"\x89PNG" else "image/jpeg"
        view = buffer.view(np.frombuffer(encoded, np.uint8))
        images.append({"name": name, "mimeType": kind, "bufferView": view})
    textures = [{"name": name, "source": i, "sampler": 0} for i, name in enumerate(names)]
    sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}
    return {"images": images, "samplers": [sampler], "textures": textures}


def _primitives(buffer: Buffer, character: Character, triangles: Int[np.ndarray, "f 3"]) -> list[dict[str, Any]]:
    """One primitive per material; all share the same vertices."""
    used, local = _compact(triangles)
    attributes = _attributes(buffer, character, used)
    material_of = character.materials[triangles[:, 0]]
    return [
        {"attributes": attributes, "material": int(i), "indices": _indices(buffer, local[material_of == i])}
        | _variants(character, int(i))
        for i in np.unique(material_of)
    ]


def _face_primitives(buffer: Buffer, character: Character, triangles: Int[np.ndarray, "f 3"]) -> list[dict[str, Any]]:
    """One primitive per material, with its own vertices and all morph targets."""
    made = []
    material_of = character.materials[triangles[:, 0]]
    for i in np.unique(material_of):
        used, local = _compact(triangles[material_of == i])
        made.append(
            {
                "attributes": _attributes(buffer, character, used),
                "material": int(i),
                "indices": _indices(buffer, local),
                "targets": _targets(buffer, character, used),
            }
        )
    return made


def _targets(buffer: Buffer, character: Character, used: Int[np.ndarray, " v"]) -> list[dict[str, int]]:
    """One morph target per blendshape, which stores only the vertices that it moves."""
    targets = []
    for _, at, moves, turns in character.face.on(used):
        places = buffer.view(at.astype(np.uint16)) if len(at) else -1
        targets.append(
            {
                "POSITION": buffer.sparse(len(used), places, stepped(moves, MOVE_STEP), bounds=True),
                "NORMAL": buffer.sparse(len(used), places, stepped(turns, TURN_STEP)),
            }
        )
    return targets


def _attributes(buffer: Buffer, character: Character, used: Int[np.ndarray, " v"]) -> dict[str, int]:
    linear = (character.colours[used] / 255.0) ** 2.2
    colours = np.concatenate([linear, np.ones((len(linear), 1))], 1)
    weights = character.weights[used]
    return {
        "POSITION": buffer.add(stepped(character.positions[used], PLACE_STEP), target=ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(_unit(character.normals[used]), target=ARRAY_BUFFER),
        "TEXCOORD_0": buffer.add(stepped(character.uvs[used], PLACE_STEP), target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(
            np.round(colours * 1023).astype(np.uint16) * 64 + 63, target=ARRAY_BUFFER, normalized=True
        ),
        "JOINTS_0": buffer.add(np.where(weights > 0, character.joints[used], 0).astype(np.uint8), target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(_integer_weights(weights), target=ARRAY_BUFFER, normalized=True),
    }


def _integer_weights(weights: Float[np.ndarray, "v 4"]) -> UInt8[np.ndarray, "v 4"]:
    """Weights as integers whose sum is exactly 255."""
    whole = np.round(weights * 255).astype(np.int64)
    whole[np.arange(len(whole)), whole.argmax(1)] += 255 - whole.sum(1)
    return whole.astype(np.uint8)


def stepped(values: Float[np.ndarray, "n d"], step: float) -> Float[np.ndarray, "n d"]:
    """Values rounded to multiples of a power of two: the last bits are 0, and the file packs to half the size."""
    return (np.round(values / step) * step).astype(np.float32)


def _unit(normals: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """Unit normals whose last bits are 0, which changes their length by less than a validator allows."""
    rounded = stepped(normals, NORMAL_STEP)
    unit = rounded / np.linalg.norm(rounded, axis=1, keepdims=True)
    return stepped(unit, 2.0**-13)


def _indices(buffer: Buffer, triangles: Int[np.ndarray, "f 3"]) -> int:
    small = np.uint16 if triangles.max() < 65535 else np.uint32
    return buffer.add(triangles.reshape(-1).astype(small), target=ELEMENT_ARRAY_BUFFER)


def _compact(triangles: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, "f 3"]]:
    """The vertices in use, and the triangles as indices into these."""
    used, local = np.unique(triangles, return_inverse=True)
    return used, local.reshape(-1, 3)


TRANSFORM, VARIANTS = "KHR_texture_transform", "KHR_materials_variants"
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
    """The GLB's bytes; `compact` stores rotations in 16 bits (error below 0.01 degrees), the face in 8."""
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
        "extensionsUsed": [TRANSFORM],
        "materials": materials(character),
        "meshes": meshes(buffer, character),
        **pictures(buffer, character),
        "skins": [_skin(buffer)],
    }  # fmt: skip
    if len(character.outfits) > 1:
        document["extensionsUsed"].append(VARIANTS)
        document["extensions"] = {VARIANTS: {"variants": [{"name": name} for name in character.outfits]}}
    return document, buffer


def packed(document: dict[str, Any], buffer: Buffer, more: Sequence[dict[str, Any]] = ()) -> bytes:
    """The bytes of a GLB with all that was collected in the buffer; `more` buffers have no bytes in the file."""
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}, *more],
    }
    return container(document, buffer.data)


def _nodes() -> list[dict[str, Any]]:
    """Nodes of the joints, the meshes, and the halfway bones, which are children of their bones' parents."""
    nodes = joint_nodes(HUMANOID)
    nodes += [{"name": "body", "mesh": 0, "skin": 0}, {"name": "face", "mesh": 1, "skin": 0}]
    for name, source, parent in zip(BONES[HUMANOID.joints :], SOURCES, PARENTS, strict=True):
        nodes[parent]["children"].append(len(nodes))
        nodes.append({"name": name, "translation": nodes[source]["translation"]})
    return nodes


def joint_nodes(skeleton: Skeleton) -> list[dict[str, Any]]:
    """A node for each joint."""
    places = zip(skeleton.names, skeleton.config.offsets, strict=True)
    nodes = [{"name": name, "translation": list(place)} for name, place in places]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        nodes[parent].setdefault("children", []).append(joint)  # type: ignore[attr-defined]
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


def container(document: dict[str, Any], binary: bytes | bytearray) -> bytes:
    """The bytes of a GLB with this JSON and this buffer, whose length is a multiple of four."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total)
    sizes = struct.pack("<I4s", len(text), b"JSON"), struct.pack("<I4s", len(binary), b"BIN\0")
    return b"".join([head, sizes[0], text, sizes[1], binary])
