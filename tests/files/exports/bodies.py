"""Three rigs of other proportions than ours, each a kind of file with a trap of its own. Nothing in them is anyone's.

* child.vrm: VRM 0.x, faces -Z, large head, short limbs, five vowels;
* tall.bvh: Mixamo names, centimetres, hips at the origin (its floor is far below 0);
* longarm.glb: Mixamo names, an armature scaled by 0.01, arms at rest in an A-pose, bones with rotations of their own.
"""

import json
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
from tests.motion.kinematics.naming import FRAMED, body

from echoavatar.files.avatar.gltf import Buffer
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix

NAMES = HUMANOID.names
MIXAMO = body(*FRAMED["Mixamo"]).bones
VOWELS = {"a": (0.0, 0.06), "i": (0.02, 0.015), "u": (-0.03, 0.02), "e": (0.03, 0.01), "o": (-0.015, 0.045)}
_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64) / 2
_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CORNERS = _CUBE[_FACES].reshape(-1, 3)
TRIANGLES = np.arange(24).reshape(6, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1)
_RINGS = np.linspace(-np.pi / 2, np.pi / 2, 9)
_TURNS = np.linspace(0, 2 * np.pi, 13)


def _round() -> np.ndarray:
    """A ball of diameter 1, in quads."""

    def point(ring: int, turn: int) -> list[float]:
        high, round_ = _RINGS[ring], _TURNS[turn]
        return [np.cos(high) * np.sin(round_) / 2, np.sin(high) / 2, np.cos(high) * np.cos(round_) / 2]

    quads = [
        [point(ring, turn), point(ring, turn + 1), point(ring + 1, turn + 1), point(ring + 1, turn)]
        for ring in range(8)
        for turn in range(12)
    ]
    return np.array(quads).reshape(-1, 3)


ROUND = _round()
_AS_VRM0 = {"ThumbMetacarpal": "ThumbProximal", "ThumbProximal": "ThumbIntermediate"}


def offsets_of(*, body: float, legs: float, arms: float, hands: float = 1.0) -> np.ndarray:
    """Our rest offsets with other proportions; the soles are on the floor."""
    offsets = np.array(HUMANOID.config.offsets) * body
    for joint, name in enumerate(NAMES):
        if "Leg" in name or "Foot" in name:
            offsets[joint] *= legs if "Upper" not in name else 1.0
        elif name.endswith(("LowerArm", "Hand")):
            offsets[joint] *= arms
        elif any(digit in name for digit in ("Thumb", "Index", "Middle", "Ring", "Little")):
            offsets[joint] *= hands
    chain = [NAMES.index(f"left{bone}") for bone in ("UpperLeg", "LowerLeg", "Foot", "Toes")]
    offsets[0] = [0, 0.02 - offsets[chain, 1].sum(), 0]
    return offsets


CHILD = offsets_of(body=0.62, legs=0.8, arms=0.85, hands=1.1)
TALL = offsets_of(body=1.12, legs=1.15, arms=1.05)
LONG_ARMED = offsets_of(body=1.0, legs=0.85, arms=1.45)


def make_rigs(folder: Path) -> dict[str, Path]:
    """All three, in a folder."""
    paths = {"child": folder / "child.vrm", "tall": folder / "tall.bvh", "longarm": folder / "longarm.glb"}
    paths["child"].write_bytes(child())
    tall(paths["tall"])
    paths["longarm"].write_bytes(long_armed())
    return paths


def child() -> bytes:
    worlds = np.tile(np.eye(4), (len(NAMES), 1, 1))
    worlds[:, :3, 3] = _places(CHILD) * [-1, 1, -1]
    document, buffer = _character([f"bone_{name}" for name in NAMES], worlds, None, head=1.5)
    mouth = len(document["nodes"]) - 1
    stretched = [CORNERS * [0.05, 0.006, 0.01] * 0 + CORNERS * [wide, tall, 0] for wide, tall in VOWELS.values()]
    document["meshes"][1]["primitives"][0]["targets"] = [
        {"POSITION": buffer.add(shape.astype(np.float32), bounds=True)} for shape in stretched
    ]
    groups = [
        {"presetName": name, "name": name.upper(), "binds": [{"mesh": 1, "index": k, "weight": 100}]}
        for k, name in enumerate(VOWELS)
    ]
    bones = [{"bone": _vrm0(name), "node": joint} for joint, name in enumerate(NAMES)]
    document["extensionsUsed"] = ["VRM"]
    document["extensions"] = {
        "VRM": {
            "specVersion": "0.0",
            "meta": {"title": "Child", "version": "1", "author": "EchoAvatar"},
            "humanoid": {"humanBones": bones},
            "blendShapeMaster": {"blendShapeGroups": groups},
        }
    }
    assert document["nodes"][mouth]["mesh"] == 1
    return _packed(document, buffer)


def tall(path: Path) -> None:
    offsets = TALL.copy()
    offsets[0] = 0
    config = SkeletonConfig(
        names=tuple(MIXAMO[name] for name in NAMES),
        parents=HUMANOID.parents,
        offsets=tuple(map(tuple, offsets.tolist())),
        tips={MIXAMO[name]: tip for name, tip in HUMANOID.config.tips.items()},
    )
    still = np.zeros((1, len(NAMES), 4), np.float32)
    still[..., 0] = 1
    write_bvh(path, Skeleton(config), still, np.zeros((1, 3), np.float32), 30)


def long_armed() -> bytes:
    config = HUMANOID.config.model_copy(update={"offsets": tuple(map(tuple, LONG_ARMED.tolist()))})
    turns = np.tile(np.eye(3, dtype=np.float32), (1, len(NAMES), 1, 1))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        turns[0, NAMES.index(f"{side}UpperArm")] = matrix_from_axis_angle(np.array([0.0, 0.0, sign * 0.8]))
    rest = forward_kinematics(Skeleton(config), turns, np.array(LONG_ARMED[:1], np.float32))
    twists = np.random.default_rng(1).standard_normal((len(NAMES), 3))
    frames = (rest.rotations[0] @ matrix_from_axis_angle(twists)).astype(np.float64)
    worlds = np.tile(np.eye(4), (len(NAMES), 1, 1))
    worlds[:, :3, :3], worlds[:, :3, 3] = 0.01 * frames, rest.positions[0]
    armature = np.diag([0.01, 0.01, 0.01, 1.0])
    document, buffer = _character([MIXAMO[name] for name in NAMES], worlds, armature, head=1.0)
    document["meshes"][1]["primitives"][0]["targets"] = [
        {"POSITION": buffer.add((CORNERS * [0, 0.05, 0]).astype(np.float32), bounds=True)}
    ]
    document["meshes"][1]["extras"] = {"targetNames": ["jawOpen"]}
    return _packed(document, buffer)


def _vrm0(name: str) -> str:
    for ours, theirs in _AS_VRM0.items():
        if name.endswith(ours):
            return name.removesuffix(ours) + theirs
    return name


def _places(offsets: np.ndarray) -> np.ndarray:
    places = offsets.copy()
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            places[joint] += places[parent]
    return places


def _character(
    names: list[str], worlds: np.ndarray, armature: np.ndarray | None, *, head: float
) -> tuple[dict[str, Any], Buffer]:
    """Joints where `worlds` says, boxes around them, and a mouth on the head."""
    buffer, top = Buffer(), 0 if armature is None else 1
    nodes: list[dict[str, Any]] = []
    for joint, (name, parent) in enumerate(zip(names, HUMANOID.parents, strict=True)):
        above = worlds[parent] if parent >= 0 else (np.eye(4) if armature is None else armature)
        nodes.append({"name": name} | _parts(np.linalg.inv(above) @ worlds[joint]))
    for joint, parent in enumerate(HUMANOID.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)
    joints = len(nodes)
    body = joints
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    skull = NAMES.index("head")
    ahead = -1.0 if worlds[NAMES.index("leftUpperArm"), 0, 3] < 0 else 1.0
    mouth = np.eye(4)
    mouth[:3, 3] = worlds[skull, :3, 3] + np.array([0, 0.06, 0.11 * ahead]) * head
    nodes.append({"name": "mouth", "mesh": 1} | _parts(np.linalg.inv(worlds[skull]) @ mouth))
    nodes[skull].setdefault("children", []).append(joints + 1)
    scene = [0, body]
    if top:
        nodes.append({"name": "Armature", "children": [0]} | _parts(armature))
        scene = [len(nodes) - 1, body]
    binds = np.stack([np.linalg.inv(world).T for world in worlds]).astype(np.float32)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "EchoAvatar tests"},
        "scene": 0,
        "scenes": [{"nodes": scene}],
        "nodes": nodes,
        "meshes": [_body(buffer, worlds[:, :3, 3], head * ahead, abs(head)), _mouth(buffer, head)],
        "skins": [{"joints": list(range(joints)), "inverseBindMatrices": buffer.add(binds)}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0, "roughnessFactor": 0.7}}
            for colour in ([0.45, 0.62, 0.72, 1], [0.55, 0.1, 0.12, 1])
        ],
    }
    return document, buffer


def _body(buffer: Buffer, places: np.ndarray, ahead: float, head: float) -> dict[str, Any]:
    """A box from each joint to its parent, turned along it; a trunk, a head, and soles on the floor."""
    points, owners = [], []

    def box(joint: int, corners: np.ndarray) -> None:
        points.append(corners)
        owners.extend([joint] * len(corners))

    for joint, parent in enumerate(HUMANOID.parents):
        if parent < 0:
            continue
        along = places[joint] - places[parent]
        length = np.linalg.norm(along)
        thick = min(max(0.012, 0.18 * length), 0.09)
        axis = along / length
        side = np.cross(axis, [0, 0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0, 0])
        side /= np.linalg.norm(side)
        frame = np.stack([axis, side, np.cross(axis, side)], 1)
        box(parent, (CORNERS * [length, thick, thick]) @ frame.T + (places[joint] + places[parent]) / 2)
    skull = NAMES.index("head")
    box(skull, ROUND * np.array([0.16, 0.22, 0.19]) * head + places[skull] + [0, 0.1 * head, 0.02 * ahead])
    broad = 0.6 * abs(places[NAMES.index("leftUpperArm"), 0])
    for bone, wide in (("hips", 1.5), ("spine", 1.25), ("chest", 1.4), ("upperChest", 1.6)):
        joint = NAMES.index(bone)
        tall = 1.6 * (places[joint + 1] - places[joint])[1]
        box(joint, ROUND * [2 * wide * broad, 2 * tall, 1.5 * wide * broad] + places[joint] + [0, tall / 2, 0])
    for side in ("left", "right"):
        ankle, toes = (NAMES.index(f"{side}{part}") for part in ("Foot", "Toes"))
        middle = (places[ankle] + places[toes]) / 2
        long = np.linalg.norm((places[toes] - places[ankle])[[0, 2]]) + 0.08
        box(ankle, CORNERS * [0.07, 0.02, long] + [middle[0], 0.01, middle[2]])
    positions = np.concatenate(points)
    joints = np.zeros((len(positions), 4), np.uint8)
    joints[:, 0] = owners
    weights = np.zeros((len(positions), 4), np.float32)
    weights[:, 0] = 1
    attributes = {
        "POSITION": buffer.add(positions.astype(np.float32), bounds=True),
        "NORMAL": buffer.add(_normals(positions)),
        "JOINTS_0": buffer.add(joints),
        "WEIGHTS_0": buffer.add(weights),
    }
    triangles = np.concatenate([TRIANGLES + 24 * k for k in range(len(positions) // 24)]).astype(np.uint16)
    return {"primitives": [{"attributes": attributes, "indices": buffer.add(triangles), "material": 0}]}


def _mouth(buffer: Buffer, head: float) -> dict[str, Any]:
    positions = CORNERS * np.array([0.06, 0.008, 0.01]) * head
    attributes = {
        "POSITION": buffer.add(positions.astype(np.float32), bounds=True),
        "NORMAL": buffer.add(_normals(positions)),
    }
    indices = buffer.add(TRIANGLES.astype(np.uint16))
    return {"primitives": [{"attributes": attributes, "indices": indices, "material": 1}]}


def _normals(positions: np.ndarray) -> np.ndarray:
    a, b, c = (positions.reshape(-1, 4, 3)[:, i] for i in range(3))
    d = positions.reshape(-1, 4, 3)[:, 3]
    normals = np.cross(c - a, d - b)  # of the diagonals: a quad at a pole has two corners in one place
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.repeat(normals, 4, axis=0).astype(np.float32)


def _parts(matrix: np.ndarray) -> dict[str, list[float]]:
    """A node's translation, rotation and scale."""
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    turn = quaternion_from_matrix(matrix[:3, :3] / scale)
    parts = {"translation": matrix[:3, 3].tolist(), "rotation": turn[[1, 2, 3, 0]].tolist()}
    return parts | ({"scale": [float(scale)] * 3} if abs(scale - 1) > 1e-9 else {})


def _packed(document: dict[str, Any], buffer: Buffer) -> bytes:
    data = bytes(buffer.data)
    document |= {"bufferViews": buffer.views, "accessors": buffer.accessors, "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    return (
        struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(data), b"BIN\0")
        + data
    )


if __name__ == "__main__":
    make_rigs(Path(sys.argv[1]))
