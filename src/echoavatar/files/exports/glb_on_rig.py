"""Write motion into the user's own character file. Its animations are replaced; everything else stays.

Local rotations are computed from the world rotations of the bones, so the file's own rest rotations and scales are
respected. The face drives morph targets with ARKit names, or else the vowels and blinks of a VRM.
"""

import copy
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import MORPHS
from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES, to_vrm
from echoavatar.motion.formats.gltf_rig import GltfRig, refusing_damage
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.resample import align_signs
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix

from ..avatar.gltf import container
from ..avatar.gltf_buffer import Buffer, Tracks
from .take import Take

_HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about Y
_VRM0 = {"a": "aa", "i": "ih", "u": "ou", "e": "ee", "o": "oh", "blink": "blink"} | {
    "blink_l": "blinkLeft",
    "blink_r": "blinkRight",
}
Array = np.ndarray


def pack_on_rig(rig: GltfRig, take: Take) -> bytes:
    """The bytes of the character's file with a take that was retargeted to it.

    Raises:
        MotionError: the character's file is damaged, or refers to other files.
    """
    with refusing_damage(rig.path):
        return _packed(rig, take)


def _packed(rig: GltfRig, take: Take) -> bytes:
    document: dict[str, Any] = copy.deepcopy(rig.document)
    buffers = document.get("buffers", [])
    if len(buffers) > 1 or (buffers and "uri" in buffers[0]):
        raise MotionError(f"{rig.path} refers to files beside it; export it as one .glb")
    buffer = Buffer()
    buffer.data = bytearray(rig.binary[: buffers[0]["byteLength"]] if buffers else b"")
    buffer.data += b"\0" * (-len(buffer.data) % 4)
    buffer.views, buffer.accessors = document.get("bufferViews", []), document.get("accessors", [])
    tracks = Tracks(buffer, take.motion.frames, take.motion.fps)
    rotations, hips = file_rotations(rig, take.motion)
    rest = file_rotations(rig, _at_rest(take.motion))[0][0]
    mapped = set(take.motion.skeleton.config.vrm.values())
    for joint, node in enumerate(rig.order):
        is_moving = bool((np.abs((rotations[:, joint] * rest[joint]).sum(-1)) < 1 - 1e-7).any())
        if joint in mapped or is_moving:
            _split_matrix(document["nodes"][node])
            tracks.add(node, "rotation", rotations[:, joint][:, [1, 2, 3, 0]])
    tracks.add(rig.order[0], "translation", hips)
    if take.face is not None:
        for node, weights in face_weights(document, take.face).items():
            tracks.add(node, "weights", weights.reshape(-1))
    document["animations"] = [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}]
    document["bufferViews"], document["accessors"] = buffer.views, buffer.accessors
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    return container(document, bytes(buffer.data))


def file_rotations(rig: GltfRig, motion: Motion) -> tuple[Float[Array, "t j 4"], Float[Array, "t 3"]]:
    """Local rotations (wxyz) of the file's nodes, and the local position of its hips."""
    world = motion.pose().rotations.double().numpy()
    root = motion.root.astype(np.float64)
    if rig.is_turned:
        world, root = _HALF_TURN @ world @ _HALF_TURN, root @ _HALF_TURN
    rest = {node: _rotation(matrix) for node, matrix in enumerate(rig.worlds)}
    slot = {node: joint for joint, node in enumerate(rig.order)}
    placed = np.stack([world[:, joint] @ rest[node] for joint, node in enumerate(rig.order)], 1)
    local = np.empty_like(placed)
    for joint, node in enumerate(rig.order):
        parent = rig.parents[node]
        if parent in slot:
            above = placed[:, slot[parent]]
        else:
            above = np.broadcast_to(rest[parent] if parent >= 0 else np.eye(3), (motion.frames, 3, 3))
        local[:, joint] = above.transpose(0, 2, 1) @ placed[:, joint]

    quaternions = quaternion_from_matrix(torch.from_numpy(local)).numpy()
    over = rig.parents[rig.order[0]]
    if over >= 0:
        inverse = np.linalg.inv(rig.worlds[over])
        root = root @ inverse[:3, :3].T + inverse[:3, 3]
    return align_signs(quaternions), root


def _at_rest(motion: Motion) -> Motion:
    still = np.zeros((1, motion.skeleton.joints, 4), np.float32)
    still[..., 0] = 1
    return Motion(motion.skeleton, still, motion.skeleton.offsets[:1].numpy(), motion.fps)


def _rotation(matrix: Float[Array, "4 4"]) -> Float[Array, "3 3"]:
    """The rotation in a node's world matrix, without its scale."""
    u, _, v = np.linalg.svd(matrix[:3, :3])
    rotation: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation


def _split_matrix(node: dict[str, Any]) -> None:
    """Write a node's matrix as translation, rotation and scale: glTF forbids animating a node with a matrix."""
    if "matrix" not in node:
        return
    matrix = np.array(node.pop("matrix"), np.float64).reshape(4, 4).T
    rotation = quaternion_from_matrix(torch.from_numpy(_rotation(matrix))).numpy()
    node["translation"] = matrix[:3, 3].tolist()
    node["rotation"] = rotation[[1, 2, 3, 0]].tolist()
    node["scale"] = np.linalg.norm(matrix[:3, :3], axis=0).tolist()


def face_weights(document: dict[str, Any], curves: Float[Array, "t 52"]) -> dict[int, Float[Array, "t n"]]:
    """Morph target weights of each node with a face; empty where the character has none."""
    nodes = document["nodes"]
    known = {name.lower(): curve for name, curve in zip(ARKIT_NAMES, curves.T, strict=True)}
    found: dict[int, Array] = {}
    total = 0
    for node, entry in enumerate(nodes):
        if "mesh" not in entry:
            continue
        names = _target_names(document["meshes"][entry["mesh"]])
        total += len(names)
        if total > MORPHS:
            raise ValueError(f"{total:,} morph targets, more than {MORPHS:,}")
        if any(name.lower() in known for name in names):
            silent = np.zeros(len(curves))
            found[node] = np.stack([known.get(name.lower(), silent) for name in names], 1)
    return found or _expression_weights(document, curves)


def _target_names(mesh: dict[str, Any]) -> list[str]:
    count = len(mesh["primitives"][0].get("targets", []))
    names = mesh.get("extras", {}).get("targetNames")
    if names is None:  # where VRM 0.x exporters put them
        targets = mesh["primitives"][0].get("targets", [])
        names = [target.get("extra", {}).get("name", "") for target in targets]
    return [str(name) for name in names] if len(names) == count else [""] * count


def _expression_weights(document: dict[str, Any], curves: Float[Array, "t 52"]) -> dict[int, Array]:
    """Morph target weights of the VRM's own vowels and blinks."""
    weights = dict(zip(VRM_NAMES, to_vrm(curves).T, strict=True))
    found: dict[int, Array] = {}
    for expression, node, index, share in _binds(document):
        if expression not in weights:
            continue
        mesh = document["meshes"][document["nodes"][node]["mesh"]]
        count = len(mesh["primitives"][0].get("targets", []))
        if 0 <= index < count:
            table = found.setdefault(node, np.zeros((len(curves), count)))
            table[:, index] += share * weights[expression]
    return {node: np.clip(table, 0, 1) for node, table in found.items()}


def _binds(document: dict[str, Any]) -> list[tuple[str, int, int, float]]:
    """(expression, node, target, weight) of a VRM 1.0 or 0.x."""
    extensions = document.get("extensions", {})
    made: list[tuple[str, int, int, float]] = []
    preset = extensions.get("VRMC_vrm", {}).get("expressions", {}).get("preset", {})
    for name, entry in preset.items():
        for bind in entry.get("morphTargetBinds", []):
            made.append((name, bind["node"], bind["index"], bind.get("weight", 1.0)))
    for group in extensions.get("VRM", {}).get("blendShapeMaster", {}).get("blendShapeGroups", []):
        name = _VRM0.get(str(group.get("presetName", "")).lower(), "")
        for bind in group.get("binds", []):
            of_mesh = [n for n, node in enumerate(document["nodes"]) if node.get("mesh") == bind["mesh"]]
            made += [(name, node, bind["index"], bind["weight"] / 100) for node in of_mesh]
    return made
