"""The user's character or skeleton (VRM, GLB or BVH): motion is retargeted to it, and written into its own file.

The skeleton stands with its soles at y = 0 and its hips above the origin, in metres, Y up, facing +Z, whatever place,
axes and unit its file has. Its rest pose has no rotations. A take is put on the same body in our rest pose and of our
size (`plain_rig`); so neither rest pose nor size changes a pose. Written into a GLB, it plays where the character
stands there, and turned, scaled or mirrored as it is. The file's animations are replaced, and everything else stays.
The face drives morph targets with ARKit names, or else the vowels and blinks of a VRM.
"""

import logging
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import BINDS, MORPHS, ROTATIONS
from echoavatar.motion.arkit import ARKIT_NAMES, VRM_NAMES, to_vrm
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.gltf_file import node_matrix, refusing_damage, rotation_of, scale_of
from echoavatar.motion.formats.gltf_rig import GltfRig, Skinned, read_gltf_rig, skinned
from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig, measure_body
from echoavatar.motion.ik.hand_contact import keep_hands_on_body, keep_hands_together
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.alignment import has_rest_pose, leg_length
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.motion.kinematics.retarget import PlainRig, plain_rig, retarget, with_wrists
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.motion.kinematics.stance import scaled, turned, upright

from ..avatar.gltf import Buffer, Tracks, packed
from .take import CENTIMETRE, Take

_log = logging.getLogger(__name__)
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
    mapped = set(take.motion.skeleton.config.vrm.values())
    for joint, node in enumerate(rig.order):
        entry = document["nodes"][node]
        is_moving = bool((np.abs(rotations[:, joint] @ rotation_of(entry)) < 1 - 1e-7).any())
        if joint in mapped or is_moving:
            _split_matrix(entry)
            tracks.add(node, "rotation", rotations[:, joint])
    tracks.add(rig.order[0], "translation", hips)
    if document.get("animations"):
        _log.warning("%s: its %d animations are left out", rig.path, len(document["animations"]))
    if take.face is not None:
        for node, weights in face_weights(document, take.face).items():
            tracks.add(node, "weights", weights.reshape(-1))
    document["animations"] = [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}]
    return packed(document, buffer)


def file_rotations(rig: GltfRig, motion: Motion) -> tuple[Float[Array, "t j 4"], Float[Array, "t 3"]]:
    """Local rotations (xyzw) of the file's nodes, and the local position of its hips.

    The skeleton's rotations are relative to a rest pose without rotations. Before and after each of them stand the axes
    of the node above and of the node itself in that pose; a node's own scale may mirror it.
    """
    above = np.concatenate([rig.turn[None], rig.frames[list(motion.skeleton.parents[1:])]])
    signs = [np.sign(scale_of(rig.document["nodes"][node])) for node in rig.order]
    local = above.swapaxes(-1, -2) @ motion.matrices().double().numpy() @ (rig.frames * np.array(signs)[:, None])
    rotations = align_signs(quaternion_from_matrix(torch.from_numpy(local)).numpy())
    root = (motion.root.astype(np.float64) - _standing_place(rig, motion.skeleton)) @ rig.turn / rig.unit
    return rotations[..., [1, 2, 3, 0]], root


def _standing_place(rig: GltfRig, skeleton: Skeleton) -> Float[Array, "3"]:
    """Our place of the origin of the hips' space in the file, where its feet are on its own floor."""
    bones, rest = skeleton.config.vrm, skeleton.rest_positions.double().numpy()
    feet = [bones["leftFoot"], bones["rightFoot"]]
    floor = min(rig.place(rig.order[foot])[1] for foot in feet) - rest[feet, 1].min()
    place: Array = -rig.place(rig.order[0]) * [1, 0, 1] - [0, floor, 0]
    return place


def _split_matrix(node: dict[str, Any]) -> None:
    """Write a node's matrix as translation, rotation and scale: glTF forbids animating a node with a matrix."""
    if "matrix" in node:
        parts = {"translation": node_matrix(node)[:3, 3], "rotation": rotation_of(node), "scale": scale_of(node)}
        node |= {name: values.tolist() for name, values in parts.items()}
        del node["matrix"]


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


@dataclass(frozen=True)
class Rig:
    """A character or skeleton that motion is retargeted to."""

    path: Path
    skeleton: Skeleton
    gltf: GltfRig | None  # None for a BVH
    units_per_metre: float  # in the file
    turn: Float[Array, "3 3"]  # from the axes of the file to ours

    def retarget(self, take: Take) -> Take:
        """The take on this rig. Planted feet stay on the floor; hands that touch each other or the body still do.

        Raises:
            MotionError: the names of the take's joints are not known.
        """
        motion, plain = with_wrists(take.motion), self._plain
        if has_rest_pose(motion.skeleton, bone_map(motion.skeleton)):
            motion = plain_rig(motion.skeleton).of_own(motion)
        moved = retarget(motion, plain.skeleton)
        moved = keep_hands_on_body(motion, moved, body_of_rig(motion.skeleton), self._plain_body)
        moved = keep_hands_together(motion, moved)
        rotations = moved.rotations[None].copy()
        HandCollisions(plain.skeleton, self._plain_body).resolve(rotations)
        moved = plain.to_own(replace(moved, rotations=rotations[0]), plain.skeleton)
        whole = np.tile(np.array([1, 0, 0, 0], np.float32), (motion.frames, self.skeleton.joints, 1))
        whole[:, self._kept] = moved.rotations
        return Take(Motion(self.skeleton, whole, self._size * moved.root, moved.fps), take.face, take.audio)

    def in_file(self, motion: Motion) -> Motion:
        """The motion in the axes and the unit of the file: a BVH."""
        return turned(motion, self.turn.T, self.units_per_metre)

    @cached_property
    def _kept(self) -> list[int]:
        """The joints from the root to every known bone.

        The others, such as those of hair and skirts, rest on their parents: nothing is computed for them.
        """
        config, kept = self.skeleton.config, set[int]()
        for joint in (*config.vrm.values(), *config.feet):
            while joint >= 0 and joint not in kept:
                kept.add(joint)
                joint = config.parents[joint]
        return sorted(kept)

    @cached_property
    def _size(self) -> float:
        """How many times as long as ours the legs are."""
        return leg_length(self.skeleton, self.skeleton.config.vrm) / leg_length(HUMANOID, HUMANOID.config.vrm)

    @cached_property
    def _plain(self) -> PlainRig:
        """The kept joints in our rest pose, with legs as long as ours."""
        config, slot = self.skeleton.config, {joint: place for place, joint in enumerate(self._kept)}
        names = [config.names[joint] for joint in self._kept]
        trunk = SkeletonConfig(
            names=tuple(names),
            parents=tuple(slot.get(config.parents[joint], -1) for joint in self._kept),
            offsets=tuple(config.offsets[joint] for joint in self._kept),
            feet=tuple(slot[joint] for joint in config.feet),
            tips={name: tip for name, tip in config.tips.items() if name in names},
            vrm={bone: slot[joint] for bone, joint in config.vrm.items()},
        )
        plain, bones = plain_rig(Skeleton(trunk)), config.vrm
        ankles = float(self.skeleton.rest_positions[[bones["leftFoot"], bones["rightFoot"]], 1].min())
        return PlainRig(scaled(_on_feet(plain.skeleton, ankles), 1 / self._size), plain.turns)

    @cached_property
    def _plain_body(self) -> BodyProfile:
        """The thickness of `_plain`, measured on the mesh, or estimated from the bones where there is no mesh."""
        estimated = body_of_rig(self._plain.skeleton)
        if self.gltf is None:
            return estimated
        try:
            skeleton, vertices, weights = skinned(self.gltf)
            measured = measure_body(scaled(skeleton, 1 / self._size), vertices / np.float32(self._size), weights)
        except MotionError:
            return estimated
        known = {part.bone: part for part in (*estimated.parts, *measured.parts)}
        return estimated.model_copy(update={"parts": tuple(known.values())})

    @cached_property
    def body(self) -> BodyProfile:
        """The body's thickness, metres."""
        return self._plain_body.scaled(self._size)


def read_rig(path: Path) -> Rig:
    """The rig of a file.

    Raises:
        MotionError: the file is missing, damaged or of another kind, or its bones are unknown or do not stand upright.
    """
    suffix = path.suffix.lower()
    if suffix in GLTF:
        gltf = read_gltf_rig(path)
        return Rig(path, _standing(path, gltf.skeleton, skinned(gltf)), gltf, 1 / gltf.unit, gltf.turn)
    if suffix != BVH:
        raise MotionError(f"{path} is not a rig: give a character (.vrm, .glb) or a skeleton (.bvh)")
    try:
        read = upright(read_bvh(path, metres_per_unit=CENTIMETRE), CENTIMETRE)
    except MotionError as error:
        raise MotionError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    return Rig(path, _standing(path, read.motion.skeleton, None), None, 1 / read.unit, read.turn)


def _standing(path: Path, skeleton: Skeleton, body: Skinned | None) -> Skeleton:
    """The skeleton with its soles at y = 0: those of the mesh of its feet, or else its lowest joint or tip."""
    bones = skeleton.config.vrm
    if not has_rest_pose(skeleton, bones):
        raise MotionError(
            f"{path}: its rest pose is no body's that stands or sits upright, with its head over its hips and its feet"
            " below; export it standing"
        )
    plain = plain_rig(skeleton).skeleton if body is None else body.skeleton
    rest = plain.rest_positions.numpy()
    feet = [bones["leftFoot"], bones["rightFoot"]]
    if body is None:
        tips = [rest[plain.index(name), 1] + tip[1] for name, tip in plain.config.tips.items()]
        low = min([*rest[:, 1].tolist(), *tips])
    else:
        of_feet = list(feet)
        for joint, parent in enumerate(plain.parents):
            of_feet += [joint] if parent in of_feet else []
        is_foot = body.weights[:, of_feet].sum(1) > 0.5
        low = body.vertices[is_foot if is_foot.any() else slice(None), 1].min()
    return _on_feet(skeleton, float(rest[feet, 1].min() - low))


def _on_feet(skeleton: Skeleton, ankles: float) -> Skeleton:
    """The skeleton with its hips above the origin, its lower ankle so far above the floor (metres)."""
    bones, config = skeleton.config.vrm, skeleton.config
    rest = skeleton.rest_positions[:, 1].double()
    root = rest[0] - rest[[bones["leftFoot"], bones["rightFoot"]]].min() + ankles
    return Skeleton(config.model_copy(update={"offsets": ((0.0, float(root), 0.0), *config.offsets[1:])}))
