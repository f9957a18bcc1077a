"""The user's character or skeleton (VRM, GLB or BVH): motion is retargeted to it, and written into its own file.

The skeleton stands with its soles at y = 0, wherever the file has its floor. Its rest pose has no rotations; the rest
rotations of the file's nodes are restored when the file is written. There its animations are replaced, and everything
else stays. Local rotations are computed from the world rotations of the bones, so the file's own rest rotations and
scales are respected.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.formats.bvh import read_standing
from echoavatar.motion.formats.gltf_data import refusing_damage
from echoavatar.motion.formats.gltf_rig import GltfRig, read_gltf_rig, skinned
from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig, measure_body
from echoavatar.motion.ik.hand_contact import keep_hands_on_body, keep_hands_together
from echoavatar.motion.kinematics import Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import JointMap, bone_map, feet_of, is_upright
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix, quaternion_multiply
from echoavatar.motion.kinematics.upright import OURS, Stand

from ..avatar.gltf import Buffer, Tracks, packed
from .rig_face import face_on
from .take import Take

_HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about Y
Array = np.ndarray


def pack_on_rig(rig: GltfRig, take: Take) -> bytes:
    """The bytes of the character's file with a take that was retargeted to it.

    Raises:
        MotionError: the character's file is damaged.
    """
    with refusing_damage(rig.path):
        return _packed(rig, take)


def _packed(rig: GltfRig, take: Take) -> bytes:
    document = rig.document | {"nodes": [dict(node) for node in rig.document["nodes"]]}
    buffers = document.get("buffers", [])
    buffer = Buffer()
    buffer.data = bytearray(memoryview(rig.binary.data)[: buffers[0]["byteLength"]] if buffers else b"")
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
        for node, weights in face_on(rig.path, document, take.face).items():
            tracks.add(node, "weights", weights.reshape(-1))
    document["animations"] = [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}]
    return packed(document, buffer, buffers[1:])


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


GLTF, BVH = (".vrm", ".glb", ".gltf"), ".bvh"
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
    raise MotionError(f"{path} is not a rig: give a character (.vrm, .glb, .gltf) or a skeleton (.bvh)")


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
