"""The character's glTF meshes: the body, and the face with its blendshapes as sparse morph targets.

The face is a separate mesh, so that only its vertices have morph targets. Each material of the face has its own
vertices.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from .character import MATERIALS, Character
from .gltf_buffer import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer
from .textures import Textures

PLACE_STEP, MOVE_STEP, NORMAL_STEP, TURN_STEP = 2.0**-14, 2.0**-14, 2.0**-7, 2.0**-5  # metres (and UVs); parts of 1


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


def materials(textures: Textures) -> list[dict[str, Any]]:
    """The glTF form of `MATERIALS`; colours of vertices are factors on the pictures."""
    index = {name: i for i, name in enumerate(textures.present)}
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
        if material.is_two_sided:
            entry["doubleSided"] = True
        if material.is_cutout:
            entry |= {"alphaMode": "MASK", "alphaCutoff": 0.5}
        made.append(entry)
    return made


def pictures(buffer: Buffer, character: Character) -> dict[str, list[dict[str, Any]]]:
    """The images, samplers and textures of a document."""
    images, names = [], character.textures.present
    for name in names:
        encoded = getattr(character.textures, name)
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
    face = character.face
    place = np.full(len(character.positions), -1)
    place[used] = np.arange(len(used))
    targets = []
    for index in range(len(face.names)):
        part = face.part(index)
        at = place[face.vertices[part]]
        here = at >= 0
        places = buffer.view(at[here].astype(np.uint16)) if here.any() else -1
        moves, turns = stepped(face.moves[part][here], MOVE_STEP), stepped(face.turns[part][here], TURN_STEP)
        targets.append(
            {
                "POSITION": buffer.sparse(len(used), places, moves, bounds=True),
                "NORMAL": buffer.sparse(len(used), places, turns),
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
