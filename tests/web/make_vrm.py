"""Makes a small VRM 1.0 avatar of boxes, with the five vowels and a blink, to drop on the page.

Nothing in it is anyone's but ours. Its bones stand in our rig's T-pose at another size, so that strides must be scaled.
"""

import json
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.motion.kinematics import HUMANOID

SCALE = 0.8
SHAPES = {"aa": (0.0, 0.06), "ih": (0.02, 0.015), "ou": (-0.03, 0.02), "ee": (0.03, 0.01), "oh": (-0.015, 0.045)}
BLINK = (0.05, 0.0)
_COMPONENTS = {"float32": 5126, "uint16": 5123, "uint8": 5121}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) / 2
_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_CORNERS = _CUBE[_FACES].reshape(-1, 3)  # four to a face, so that each has its own normal
_TRIANGLES = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1)

Box = tuple[int, np.ndarray, np.ndarray]  # joint, offset of the centre from it, size


class _Binary:
    def __init__(self) -> None:
        self.data, self.views, self.accessors = bytearray(), [], []

    def add(self, values: np.ndarray) -> int:
        values = np.ascontiguousarray(values)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        kind = _KINDS[values.shape[1:]]
        accessor: dict[str, Any] = {"bufferView": len(self.views) - 1, "count": len(values), "type": kind}
        accessor["componentType"] = _COMPONENTS[values.dtype.name]
        if kind in ("SCALAR", "VEC3"):
            accessor |= {"min": np.atleast_1d(values.min(0)).tolist(), "max": np.atleast_1d(values.max(0)).tolist()}
        self.accessors.append(accessor)
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.accessors) - 1


def make_vrm() -> bytes:
    """The file's bytes."""
    binary, offsets = _Binary(), np.array(HUMANOID.config.offsets) * SCALE
    joints, head = HUMANOID.joints, HUMANOID.names.index("head")
    nodes: list[dict[str, Any]] = [
        {"name": f"Bone_{name}", "translation": offset.tolist()}
        for name, offset in zip(HUMANOID.names, offsets, strict=True)
    ]
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
    nodes[head]["children"] = [joints + 1]
    nodes += [{"name": "body", "mesh": 0, "skin": 0}, {"name": "mouth", "mesh": 1}]
    document = {
        "asset": {"version": "2.0", "generator": "EchoAvatar tests"},
        "extensionsUsed": ["VRMC_vrm"],
        "scene": 0,
        "scenes": [{"nodes": [0, joints]}],
        "nodes": nodes,
        "meshes": [_body(binary, offsets), _mouth(binary)],
        "skins": [{"joints": list(range(joints)), "inverseBindMatrices": _bind(binary)}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0}}
            for colour in ([0.45, 0.62, 0.72, 1], [0.55, 0.1, 0.12, 1])
        ],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
        "buffers": [{"byteLength": len(binary.data)}],
        "extensions": {"VRMC_vrm": _extension(joints + 1)},
    }
    return _container(document, bytes(binary.data))


def _body(binary: _Binary, offsets: np.ndarray) -> dict[str, Any]:
    """A box from each joint to its parent, and a head, in one skinned mesh."""
    places = HUMANOID.rest_positions * SCALE
    boxes: list[Box] = [(HUMANOID.names.index("head"), np.array([0, 0.09, 0.02]), np.array([0.16, 0.2, 0.18]))]
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            offset = offsets[joint]
            thick = max(0.012, 0.18 * float(np.linalg.norm(offset)))
            boxes.append((parent, offset / 2, np.maximum(np.abs(offset), thick)))
    positions = np.concatenate([_CORNERS * size + places[joint] + centre for joint, centre, size in boxes])
    owners = np.zeros((len(positions), 4), np.uint8)
    owners[:, 0] = np.repeat([joint for joint, _, _ in boxes], 24)
    triangles = np.concatenate([_TRIANGLES + 24 * index for index in range(len(boxes))])
    attributes = {
        "POSITION": binary.add(positions.astype(np.float32)),
        "NORMAL": binary.add(np.tile(_normals(), (len(boxes), 1))),
        "JOINTS_0": binary.add(owners),
        "WEIGHTS_0": binary.add(np.eye(4, dtype=np.float32)[np.zeros(len(positions), int)]),
    }
    indices = binary.add(triangles.astype(np.uint16))
    return {"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}


def _mouth(binary: _Binary) -> dict[str, Any]:
    """A flat box with a morph target for each vowel and the blink."""
    positions = _CORNERS * [0.06, 0.008, 0.01] + [0, 0.05, 0.112]
    stretches = (*SHAPES.values(), BLINK)
    primitive = {
        "attributes": {"POSITION": binary.add(positions.astype(np.float32)), "NORMAL": binary.add(_normals())},
        "indices": binary.add(_TRIANGLES.astype(np.uint16)),
        "material": 1,
        "targets": [
            {"POSITION": binary.add((_CORNERS * [wide, tall, 0]).astype(np.float32))} for wide, tall in stretches
        ],
    }
    return {"primitives": [primitive]}


def _normals() -> np.ndarray:
    a, b, c = (_CORNERS.reshape(6, 4, 3)[:, i] for i in range(3))
    normals = np.cross(b - a, c - a)
    return np.repeat(normals / np.linalg.norm(normals, axis=1, keepdims=True), 4, axis=0).astype(np.float32)


def _bind(binary: _Binary) -> int:
    matrices = np.tile(np.eye(4, dtype=np.float32), (HUMANOID.joints, 1, 1))
    matrices[:, 3, :3] = -HUMANOID.rest_positions * SCALE
    return binary.add(matrices)


def _extension(mouth: int) -> dict[str, Any]:
    preset = {
        name: {"morphTargetBinds": [{"node": mouth, "index": index, "weight": 1.0}]}
        for index, name in enumerate((*SHAPES, "blink"))
    }
    licence = "https://vrm.dev/licenses/1.0/"
    return {
        "specVersion": "1.0",
        "meta": {"name": "Boxes", "version": "1", "authors": ["EchoAvatar"], "licenseUrl": licence},
        "humanoid": {"humanBones": {name: {"node": joint} for joint, name in enumerate(HUMANOID.names)}},
        "expressions": {"preset": preset},
    }


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(make_vrm())
