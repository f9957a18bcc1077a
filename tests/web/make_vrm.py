"""Makes a small VRM 1.0 avatar of boxes, with the five vowels and a blink: something to drop on the page.

Nothing in it is anyone's but ours. Its bones stand in our rig's T-pose at another size, so that strides must be scaled.
"""

import json
import struct
import sys
from pathlib import Path

import numpy as np

from echoavatar.kinematics import HUMANOID

SCALE = 0.8
MOUTHS = ("aa", "ih", "ou", "ee", "oh")
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) / 2
_FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], np.uint16
)


class _Binary:
    def __init__(self) -> None:
        self.data, self.views, self.accessors = bytearray(), [], []

    def add(self, values: np.ndarray) -> int:
        component = 5126 if values.dtype == np.float32 else 5123
        kind = {1: "SCALAR", 2: "VEC3"}[values.ndim]
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        low, high = np.atleast_1d(values.min(0)).tolist(), np.atleast_1d(values.max(0)).tolist()
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": component,
                "count": len(values),
                "type": kind,
                "min": low,
                "max": high,
            }
        )
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.accessors) - 1


def make_vrm() -> bytes:
    """The file's bytes."""
    binary, offsets = _Binary(), np.array(HUMANOID.config.offsets) * SCALE
    nodes = [
        {"name": f"Bone_{name}", "translation": offset.tolist()}
        for name, offset in zip(HUMANOID.names, offsets, strict=True)
    ]
    meshes = []
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
            meshes.append((parent, _limb(binary, offsets[joint])))
    head = HUMANOID.names.index("head")
    meshes.append((head, _box(binary, np.array([0, 0.09, 0.02]), np.array([0.16, 0.2, 0.18]))))
    meshes.append((head, _mouth(binary)))
    for index, (joint, mesh) in enumerate(meshes):
        nodes[joint].setdefault("children", []).append(len(nodes))
        nodes.append({"name": f"box{index}", "mesh": index})
        meshes[index] = mesh
    mouth = len(nodes) - 1
    document = {
        "asset": {"version": "2.0", "generator": "EchoAvatar tests"},
        "extensionsUsed": ["VRMC_vrm"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0}}
            for colour in ([0.45, 0.62, 0.72, 1], [0.55, 0.1, 0.12, 1])
        ],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
        "buffers": [{"byteLength": len(binary.data)}],
        "extensions": {"VRMC_vrm": _extension(mouth)},
    }
    return _container(document, bytes(binary.data))


def _limb(binary: _Binary, offset: np.ndarray) -> dict:
    """A box from a joint to its child."""
    size = np.maximum(np.abs(offset), max(0.012, 0.18 * float(np.linalg.norm(offset))))
    return _box(binary, offset / 2, size)


def _box(binary: _Binary, centre: np.ndarray, size: np.ndarray, material: int = 0) -> dict:
    corners = _CORNERS[_FACES].reshape(-1, 3)
    positions = (corners * size + centre).astype(np.float32)
    triangles = np.arange(24, dtype=np.uint16).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1)
    a, b, c = (corners.reshape(6, 4, 3)[:, i] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals = np.repeat(normals / np.linalg.norm(normals, axis=1, keepdims=True), 4, axis=0)
    attributes = {"POSITION": binary.add(positions), "NORMAL": binary.add(normals.astype(np.float32))}
    return {
        "primitives": [{"attributes": attributes, "indices": binary.add(triangles), "material": material}]
    }


def _mouth(binary: _Binary) -> dict:
    """A flat box that each vowel, and the blink, stretches its own way."""
    mesh = _box(binary, np.array([0, 0.05, 0.112]), np.array([0.06, 0.008, 0.01]), material=1)
    corners = _CORNERS[_FACES].reshape(-1, 3)
    stretches = [(0.0, 0.06), (0.02, 0.015), (-0.03, 0.02), (0.03, 0.01), (-0.015, 0.045), (0.05, 0.0)]
    targets = [
        {"POSITION": binary.add((corners * [wide, tall, 0]).astype(np.float32))} for wide, tall in stretches
    ]
    mesh["primitives"][0]["targets"] = targets
    return mesh


def _extension(mouth: int) -> dict:
    bones = {name: {"node": joint} for joint, name in enumerate(HUMANOID.names)}
    preset = {
        name: {"morphTargetBinds": [{"node": mouth, "index": index, "weight": 1.0}]}
        for index, name in enumerate((*MOUTHS, "blink"))
    }
    licence = "https://vrm.dev/licenses/1.0/"
    meta = {"name": "Boxes", "version": "1", "authors": ["EchoAvatar"], "licenseUrl": licence}
    return {
        "specVersion": "1.0",
        "meta": meta,
        "humanoid": {"humanBones": bones},
        "expressions": {"preset": preset},
    }


def _container(document: dict, binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(make_vrm())
