"""The user's character or skeleton (VRM, GLB or BVH): motion is retargeted to it, and written into its own file.

The skeleton stands with its soles at y = 0, wherever the file has its floor. Its rest pose has no rotations; the rest
rotations of the file's nodes are restored when the file is written. There its animations are replaced, and everything
else stays. Local rotations are computed from the world rotations of the bones, so the file's own rest rotations and
scales are respected. The face drives morph targets with ARKit names, or else the vowels and blinks of a VRM.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import BINDS, MORPHS, ROTATIONS
from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES, to_vrm
from echoavatar.motion.formats.bvh import read_standing
from echoavatar.motion.formats.gltf_rig import GltfRig, read_gltf_rig, refusing_damage, skinned
from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig, measure_body
from echoavatar.motion.ik.hand_contact import keep_hands_on_body, keep_hands_together
from echoavatar.motion.kinematics import Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import JointMap, bone_map, feet_of, is_upright
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix, quaternion_multiply
from echoavatar.motion.kinematics.upright import OURS, Stand

from ..avatar.gltf import Buffer, Tracks, packed
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
    document = rig.document | {"nodes": [dict(node) for node in rig.document["nodes"]]}
    buffers = document.get("buffers", [])
    if len(buffers) > 1 or (buffers and "uri" in buffers[0]):
        raise MotionError(f"{rig.path} refers to files beside it; export it as one .glb")
    buffer = Buffer()
    buffer.data = bytearray(memoryview(rig.binary)[: buffers[0]["byteLength"]] if buffers else b"")
    buffer.data += b"\0" * (-len(buffer.data) % 4)
    buffer.views, buffer.accessors = (list(document.get(key, [])) for key in ("bufferViews", "accessors"))
    tracks = Tracks(buffer, take.motion.frames, take.motion.fps)
    rotations, hips = file_rotations(rig, take.motion)
    rest = file_rotations(rig, Motion.at_rest(take.motion.skeleton))[0][0]
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
    return packed(document, buffer)


def file_rotations(rig: GltfRig, motion: Motion) -> tuple[Float[Array, "t j 4"], Float[Array, "t 3"]]:
    """Local rotations (wxyz) of the file's nodes, and the local position of its hips.

    The skeleton's rotations are relative to a rest pose without rotations: between them stand those of the file's node
    and of its parent at rest.
    """
    local = motion.rotations.astype(np.float64)
    root = motion.root.astype(np.float64)
    if rig.is_turned:
        local *= [1, -1, 1, -1]
        root = root @ _HALF_TURN
    for joint, node in enumerate(rig.order):
        parent = rig.parents[node]
        above = _rotation(rig.worlds[parent]) if parent >= 0 else np.eye(3)
        before, after = (quaternion_from_matrix(torch.from_numpy(m)) for m in (above.T, _rotation(rig.worlds[node])))
        turned = quaternion_multiply(torch.from_numpy(local[:, joint]), after)
        local[:, joint] = quaternion_multiply(before, turned).numpy()

    over = rig.parents[rig.order[0]]
    if over >= 0:
        inverse = np.linalg.inv(rig.worlds[over])
        root = root @ inverse[:3, :3].T + inverse[:3, 3]
    return align_signs(local), root


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
        if total * len(curves) > ROTATIONS:
            raise ValueError(f"{total:,} morph targets in {len(curves):,} frames, more than is written; cut the take")
        if any(name.lower() in known for name in names):
            silent = np.zeros(len(curves), np.float32)
            found[node] = np.stack([known.get(name.lower(), silent) for name in names], 1)
    return found or _expression_weights(document, curves)


def _target_names(mesh: dict[str, Any]) -> list[str]:
    targets = mesh["primitives"][0].get("targets", [])
    names = mesh.get("extras", {}).get("targetNames")
    if names is None:  # where VRM 0.x exporters put them
        names = [target.get("extra", {}).get("name", "") for target in targets]
    return [str(name) for name in names] if len(names) == len(targets) else [""] * len(targets)


def _expression_weights(document: dict[str, Any], curves: Float[Array, "t 52"]) -> dict[int, Array]:
    """Morph target weights of the VRM's own vowels and blinks."""
    shares: dict[int, Array] = {}  # of each expression (rows) in each target of a node
    for expression, node, index, share in _binds(document):
        if expression not in VRM_NAMES:
            continue
        mesh = document["meshes"][document["nodes"][node]["mesh"]]
        count = len(mesh["primitives"][0].get("targets", []))
        if 0 <= index < count:
            table = shares.setdefault(node, np.zeros((len(VRM_NAMES), count), np.float32))
            table[VRM_NAMES.index(expression), index] += share
    return {node: np.clip(to_vrm(curves) @ table, 0, 1) for node, table in shares.items()}


def _binds(document: dict[str, Any]) -> list[tuple[str, int, int, float]]:
    """(expression, node, target, weight) of a VRM 1.0 or 0.x."""
    extensions = document.get("extensions", {})
    made: list[tuple[str, int, int, float]] = []
    preset = extensions.get("VRMC_vrm", {}).get("expressions", {}).get("preset", {})
    for name, entry in preset.items():
        for bind in entry.get("morphTargetBinds", []):
            made.append((name, bind["node"], bind["index"], bind.get("weight", 1.0)))
            _check_binds(made)
    users: defaultdict[int, list[int]] = defaultdict(list)  # the nodes of each mesh
    for node, entry in enumerate(document["nodes"]):
        if "mesh" in entry:
            users[entry["mesh"]].append(node)
    for group in extensions.get("VRM", {}).get("blendShapeMaster", {}).get("blendShapeGroups", []):
        name = _VRM0.get(str(group.get("presetName", "")).lower(), "")
        for bind in group.get("binds", []):
            for node in users[bind["mesh"]]:
                made.append((name, node, bind["index"], bind["weight"] / 100))
                _check_binds(made)
    return made


def _check_binds(made: list[tuple[str, int, int, float]]) -> None:
    """Refuse more binds than expressions have; a bind of VRM 0.x counts for each node of its mesh."""
    if len(made) > BINDS:
        raise ValueError(f"expressions that name more than {BINDS:,} morph targets")


GLTF, BVH = (".vrm", ".glb"), ".bvh"
_SMALLEST, _LARGEST = 0.2, 20.0  # metres from sole to hips


@dataclass(frozen=True)
class Rig:
    """A character or skeleton that motion is retargeted to."""

    path: Path
    skeleton: Skeleton
    gltf: GltfRig | None  # None for a BVH
    stand: Stand = OURS  # of a BVH: its unit and axes

    def retarget(self, take: Take) -> Take:
        """The take on this rig. Planted feet stay on the floor; hands that touch each other or the body still do.

        Raises:
            MotionError: the names of the take's joints are not known.
        """
        motion, body, (trunk, kept) = take.motion, self.body, self._trunk
        moved = keep_hands_on_body(motion, retarget(motion, trunk), body_of_rig(motion.skeleton), body)
        moved = keep_hands_together(motion, moved)
        rotations = moved.rotations[None].copy()
        HandCollisions(trunk, body).resolve(rotations)
        whole = np.tile(np.array([1, 0, 0, 0], np.float32), (motion.frames, self.skeleton.joints, 1))
        whole[:, kept] = rotations[0]
        return Take(Motion(self.skeleton, whole, moved.root, moved.fps), take.face, take.audio)

    @cached_property
    def _trunk(self) -> tuple[Skeleton, list[int]]:
        """The joints from the root to every known bone as a skeleton, and their places in the rig's.

        The others, such as those of hair and skirts, rest on their parents: nothing is computed for them.
        """
        config, kept = self.skeleton.config, set[int]()
        for joint in (*bone_map(self.skeleton).values(), *config.feet):
            while joint >= 0 and joint not in kept:
                kept.add(joint)
                joint = config.parents[joint]
        order = sorted(kept)
        slot = {joint: place for place, joint in enumerate(order)}
        names = [config.names[joint] for joint in order]
        trunk = SkeletonConfig(
            names=tuple(names),
            parents=tuple(slot.get(config.parents[joint], -1) for joint in order),
            offsets=tuple(config.offsets[joint] for joint in order),
            feet=tuple(slot[joint] for joint in config.feet),
            tips={name: tip for name, tip in config.tips.items() if name in names},
            vrm={bone: slot[joint] for bone, joint in bone_map(self.skeleton).items()},
        )
        return Skeleton(trunk), order

    @cached_property
    def body(self) -> BodyProfile:
        """The body's thickness, measured on the mesh, or estimated from the bones where there is no mesh."""
        estimated = body_of_rig(self.skeleton)
        if self.gltf is None:
            return estimated
        try:
            measured = measure_body(self.gltf.skeleton, *skinned(self.gltf)[1:])
        except MotionError:
            return estimated
        known = {part.bone: part for part in (*estimated.parts, *measured.parts)}
        return estimated.model_copy(update={"parts": tuple(known.values())})


def read_rig(path: Path, given: JointMap | None = None) -> Rig:
    """The rig of a file; `given` is the user's map of its bones.

    Raises:
        MotionError: the file is missing, damaged or of another kind, or its bones are unknown or do not stand upright.
    """
    suffix = path.suffix.lower()
    if suffix in GLTF:
        gltf = read_gltf_rig(path, given)
        low = float(skinned(gltf).vertices[:, 1].min())
        return Rig(path, _standing(gltf.skeleton, low, path), gltf)
    if suffix == BVH:
        motion, stand = read_standing(path, given)
        return Rig(path, _standing(motion.skeleton, _lowest(motion.skeleton), path), None, stand)
    raise MotionError(f"{path} is not a rig: give a character (.vrm, .glb) or a skeleton (.bvh)")


def _lowest(skeleton: Skeleton) -> float:
    """Height of the lowest joint or tip, metres."""
    rest = skeleton.rest_positions.numpy()
    tips = [rest[skeleton.index(name), 1] + tip[1] for name, tip in skeleton.config.tips.items()]
    return float(min([*rest[:, 1].tolist(), *tips]))


def _standing(skeleton: Skeleton, low: float, path: Path) -> Skeleton:
    """The skeleton raised or lowered so that the height `low` becomes 0, with bone map and feet filled in."""
    try:
        bones = bone_map(skeleton)
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error
    config = skeleton.config
    offsets = np.array(config.offsets)
    offsets[0, 1] -= low
    feet = config.feet or tuple(feet_of(bones))
    placed = Skeleton(
        config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist())), "vrm": bones, "feet": feet})
    )
    hips = float(placed.rest_positions[bones["hips"], 1])
    if not is_upright(placed, bones) or not _SMALLEST < hips < _LARGEST:
        raise MotionError(
            f"{path}: its rest pose does not stand upright (Y up, hips {hips:.2f} m above the"
            " floor); export it standing, in metres (BVH: in centimetres)"
        )
    return placed
