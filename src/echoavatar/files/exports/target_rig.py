"""The user's character or skeleton (VRM, GLB or BVH): motion is retargeted to it, and written into its own file.

The skeleton stands with its soles at y = 0 and its hips above the origin, in metres, Y up, facing +Z, whatever place,
axes and unit its file has. Its rest pose has no rotations. Takes are retargeted to the same body in our rest pose and
size (`plain_rig`), so neither rest pose nor size changes a pose. Written into a GLB, a take plays where the character
stands, turned, scaled and mirrored as it is. The file's animations are replaced, and everything else stays.
"""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.formats.bvh import read_standing
from echoavatar.motion.formats.gltf_data import refusing_damage
from echoavatar.motion.formats.gltf_nodes import node_matrix, rotation_of, scale_of
from echoavatar.motion.formats.gltf_rig import GltfRig, Skinned, read_gltf_rig, skinned
from echoavatar.motion.formats.kinds import BVH, GLTF, kind_of
from echoavatar.motion.formats.reading import reading
from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig, measure_body
from echoavatar.motion.ik.hand_contact import keep_hands_on_body, keep_hands_together
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.alignment import has_rest_pose, leg_length
from echoavatar.motion.kinematics.joint_tree import with_parents
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.motion.kinematics.retarget import PlainRig, plain_rig, retarget, with_wrists
from echoavatar.motion.kinematics.rigs import JointMap, bone_map, feet_of
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.motion.kinematics.upright import OURS, Stand, scaled

from ..avatar.gltf import Buffer, Tracks, packed
from .rig_face import face_on
from .take import Take

_log = logging.getLogger(__name__)
Array = np.ndarray


def pack_on_rig(rig: GltfRig, take: Take) -> bytes:
    """The bytes of the character's file with a take that was retargeted to it.

    Raises MotionError: the character's file is damaged.
    """
    with refusing_damage(rig.path):
        document = rig.document | {"nodes": [dict(node) for node in rig.document["nodes"]]}
        buffers = document.get("buffers", [])
        buffer = Buffer()
        buffer.data = bytearray(memoryview(rig.data)[: buffers[0]["byteLength"]] if buffers else b"")
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
            for node, weights in face_on(rig.path, document, take.face).items():
                tracks.add(node, "weights", weights.reshape(-1))
        document["animations"] = [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}]
        return packed(document, buffer, buffers[1:])


def file_rotations(rig: GltfRig, motion: Motion) -> tuple[Float[Array, "t j 4"], Float[Array, "t 3"]]:
    """Local rotations (xyzw) of the file's nodes, and the local position of its hips.

    The skeleton's rotations are relative to a rest pose without rotations. Before and after each of them stand the axes
    of the node above and of the node itself in that pose; a node's own scale may mirror it.
    """
    above = np.concatenate([rig.turn[None], rig.frames[list(motion.skeleton.parents[1:])]])
    signs = [np.sign(scale_of(rig.document["nodes"][node])) for node in rig.order]
    local = above.swapaxes(-1, -2) @ motion.matrices().astype(np.float64) @ (rig.frames * np.array(signs)[:, None])
    rotations = align_signs(quaternion_from_matrix(local))
    root = (motion.root.astype(np.float64) - _standing_place(rig, motion.skeleton)) @ rig.turn / rig.unit
    return rotations[..., [1, 2, 3, 0]], root


def _standing_place(rig: GltfRig, skeleton: Skeleton) -> Float[Array, "3"]:
    """The skeleton's coordinates of the origin of the hips' space, if the character stands as in its file; metres."""
    bones, rest = skeleton.config.vrm, skeleton.rest_positions.astype(np.float64)
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


@dataclass(frozen=True)
class Rig:
    """A character or skeleton that motion is retargeted to."""

    path: Path
    skeleton: Skeleton
    gltf: GltfRig | None  # None for a BVH
    stand: Stand = OURS  # of a BVH: its unit and axes

    @property
    def has_mesh(self) -> bool:
        """Whether the file has anything to show."""
        return self.gltf is not None and any("mesh" in node for node in self.gltf.document["nodes"])

    def retarget(self, take: Take) -> Take:
        """The take on this rig. Planted feet stay on the floor; hands that touch each other or the body still do.

        Raises MotionError: the names of the take's joints are not known.
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

    @cached_property
    def _kept(self) -> list[int]:
        """The joints from the root to every known bone.

        The others, such as those of hair and skirts, rest on their parents: nothing is computed for them.
        """
        config = self.skeleton.config
        return sorted(with_parents((*config.vrm.values(), *config.feet), config.parents))

    @cached_property
    def _size(self) -> float:
        """Length of the legs over that of ours."""
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


def read_rig(path: Path, given: JointMap | None = None) -> Rig:
    """The rig of a file; `given` is the user's map of its bones.

    Raises:
        MotionError: the file is missing, damaged or of another kind, or its bones are unknown or do not stand upright.
        DependencyError: the file is compressed, and the package that unpacks it is missing.
    """
    with reading(path):
        kind = kind_of(path)
        if kind == GLTF:
            gltf = read_gltf_rig(path, given)
            rig = Rig(path, gltf.skeleton, gltf)
            return replace(rig, skeleton=_standing(gltf.skeleton, skinned(gltf) if rig.has_mesh else None))
        if kind != BVH:
            raise MotionError(f"{path} is not a rig: convert it to a character (.glb, .vrm) or a skeleton (.bvh)")
        motion, stand = read_standing(path, given)
        config, bones = motion.skeleton.config, bone_map(motion.skeleton)
        known = config.model_copy(update={"vrm": bones, "feet": config.feet or tuple(feet_of(bones))})
        return Rig(path, _standing(Skeleton(known), None), None, stand)


def _standing(skeleton: Skeleton, body: Skinned | None) -> Skeleton:
    """The skeleton with its soles at y = 0: those of the mesh of its feet, or else its lowest joint or tip."""
    bones = skeleton.config.vrm
    if not has_rest_pose(skeleton, bones):
        raise MotionError(
            "its rest pose is no body's that stands or sits upright, with its head over its hips and its feet"
            " below; export it standing"
        )
    plain = plain_rig(skeleton).skeleton if body is None else body.skeleton
    rest = plain.rest_positions
    feet = [bones["leftFoot"], bones["rightFoot"]]
    if body is None:
        tips = [rest[plain.index(name), 1] + tip[1] for name, tip in plain.config.tips.items()]
        low = min([*rest[:, 1].tolist(), *tips])
    else:
        of_feet = list(feet)
        for joint, parent in enumerate(plain.parents):
            of_feet += [joint] if parent in of_feet else []
        is_foot = body.weights.on(of_feet) > 0.5
        low = body.vertices[is_foot if is_foot.any() else slice(None), 1].min()
    return _on_feet(skeleton, float(rest[feet, 1].min() - low))


def _on_feet(skeleton: Skeleton, ankles: float) -> Skeleton:
    """The skeleton with its hips above the origin, its lower ankle so far above the floor (metres)."""
    bones, rest = skeleton.config.vrm, skeleton.rest_positions[:, 1].astype(np.float64)
    root = rest[0] - rest[[bones["leftFoot"], bones["rightFoot"]]].min() + ankles
    return skeleton.with_offsets([(0.0, root, 0.0), *skeleton.config.offsets[1:]])
