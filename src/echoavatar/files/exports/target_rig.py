"""The user's character or skeleton as the target of retargeting, read from a VRM, GLB or BVH.

The skeleton stands with its soles at y = 0, wherever the file has its floor. Its rest pose has no rotations; the rest
rotations of the file's nodes are restored when the file is written.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.gltf_rig import GltfRig, read_gltf_rig
from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig, measure_body
from echoavatar.motion.ik.body_contact import keep_hands_on_body
from echoavatar.motion.ik.skinned import skinned
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.kinematics.hand_contact import keep_hands_together
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix

from .take import Take

GLTF, BVH = (".vrm", ".glb"), ".bvh"
_SMALLEST, _LARGEST = 0.2, 20.0  # metres from sole to hips
_UNITS = (0.01, 1.0, 0.0254, 0.001)  # metres per unit of a BVH, the usual one first


@dataclass(frozen=True)
class Rig:
    """A character or skeleton that motion is retargeted to."""

    path: Path
    skeleton: Skeleton
    gltf: GltfRig | None  # None for a BVH
    units_per_metre: float = 100.0  # in the BVH

    def retarget(self, take: Take) -> Take:
        """The take on this rig. Planted feet stay on the floor; hands that touch each other or the body still do.

        Raises:
            MotionError: the names of the take's joints are not known.
        """
        motion, body = take.motion, self.body
        moved = keep_hands_on_body(motion, retarget(motion, self.skeleton), body_of_rig(motion.skeleton), body)
        moved = keep_hands_together(motion, moved)
        matrices = HandCollisions(self.skeleton, body).step(moved.matrices()[None])[0]
        moved = replace(moved, rotations=quaternion_from_matrix(matrices).numpy())
        return Take(moved, take.face, take.audio)

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


def read_rig(path: Path) -> Rig:
    """The rig of a file.

    Raises:
        MotionError: the file is missing, damaged or of another kind, its bones are not known, or it does not stand.
    """
    suffix = path.suffix.lower()
    if suffix in GLTF:
        gltf = read_gltf_rig(path)
        low = float(skinned(gltf).vertices[:, 1].min())
        return Rig(path, _standing(gltf.skeleton, low, path), gltf)
    if suffix == BVH:
        motion, unit = _sized(path)
        low = _lowest(motion.skeleton)
        return Rig(path, _standing(motion.skeleton, low, path), None, 1 / unit)
    raise MotionError(f"{path} is not a rig: give a character (.vrm, .glb) or a skeleton (.bvh)")


def _sized(path: Path) -> tuple[Motion, float]:
    """The file's motion in metres, and metres per unit: the first usual unit that gives the figure a body's height."""
    for unit in _UNITS:
        motion = read_bvh(path, metres_per_unit=unit)
        places = motion.skeleton.rest_positions
        tall = float(places[:, 1].max() - places[:, 1].min())
        if 0.3 < tall < 4.0:
            return motion, unit
    raise MotionError(
        f"{path}: its figure is {1000 * tall:.0f} units tall, which is no person's height in metres, centimetres,"
        " inches or millimetres; export it standing, in one of these units"
    )


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
    feet = config.feet or tuple(
        bones.get(f"{side}{part}", bones[f"{side}Foot"]) for side in ("left", "right") for part in ("Foot", "Toes")
    )
    placed = Skeleton(
        config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist())), "vrm": bones, "feet": feet})
    )
    rest = placed.rest_positions
    is_upright = bool(rest[bones["head"], 1] > rest[bones["hips"], 1] > rest[bones["leftFoot"], 1])
    if not is_upright or not _SMALLEST < float(rest[bones["hips"], 1]) < _LARGEST:
        raise MotionError(
            f"{path}: its rest pose does not stand upright (Y up, hips {float(rest[bones['hips'], 1]):.2f} m above the"
            " floor); export it standing, in metres (BVH: in centimetres)"
        )
    return placed
