"""How a rig stands, measured from where its bones are at rest: which way is up and ahead, and how long its unit is.

Clips and rigs of every format are measured here, so that the same body stands in the same way as both.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import ArrayLike

from echoavatar.errors import MotionError

from .alignment import has_rest_pose
from .motion import Motion
from .rigs import bone_map, feet_of
from .rotations import quaternion_from_matrix
from .skeleton import Skeleton

Array = np.ndarray
Places = Mapping[str, Float[Array, "3"]]  # of VRM bones, in the rig's unit and axes
UNITS = (1.0, 0.01, 0.001, 0.0254, 0.3048, 10.0, 100.0)  # metres; those that files are written in
_STATURE = 1.18  # of a body whose legs and trunk, up to the joint of the head, are 1 long
_ADULT, _ANYONE, _MEAN = (1.3, 2.2), (0.5, 3.0), 1.7  # metres
_LEANING, _TURNED = (
    0.94,
    0.99998,
)  # cosines of 20 degrees and of a third of one: as far from its axes a body stands and faces


class Upright(NamedTuple):
    """A motion in our axes and metres, and how it got there."""

    motion: Motion
    turn: Float[Array, "3 3"]  # from its file's axes to ours
    unit: float  # metres in the file's unit


def upright(motion: Motion, unit: float) -> Upright:
    """The motion of a file in our axes and metres, its bones named. `unit` is what was taken for the file's, metres.

    A rig whose rest pose is no body's keeps its axes; its bones tell the unit all the same.

    Raises:
        MotionError: the rig's bones are not known, or their places are no body's.
    """
    bones, rest = bone_map(motion.skeleton), motion.skeleton.rest_positions.double().numpy() / unit
    places = {bone: rest[joint] for bone, joint in bones.items()}
    measured = metres_per_unit(places)
    for turn in (axes_of(places), np.eye(3)):
        moved = turned(motion, turn, measured / unit)
        if has_rest_pose(moved.skeleton, bones):
            break
    config = moved.skeleton.config
    skeleton = Skeleton(config.model_copy(update={"vrm": bones, "feet": config.feet or tuple(feet_of(bones))}))
    return Upright(Motion(skeleton, moved.rotations, moved.root, motion.fps), turn, measured)


def turned(motion: Motion, turn: Float[Array, "3 3"], factor: float) -> Motion:
    """The motion and its rig with all their places turned (and mirrored) by a matrix, and so many times as large."""

    def put(places: ArrayLike) -> Array:
        put: Array = factor * np.asarray(places, np.float64) @ turn.T
        return put

    config, matrix = motion.skeleton.config, torch.from_numpy(turn)
    update = {
        "offsets": tuple(map(tuple, put(config.offsets).tolist())),
        "tips": {name: tuple(put(tip).tolist()) for name, tip in config.tips.items()},
    }
    rotations = quaternion_from_matrix(matrix @ motion.matrices().double() @ matrix.T).numpy().astype(np.float32)
    skeleton = Skeleton(config.model_copy(update=update))
    return Motion(skeleton, rotations, put(motion.root).astype(np.float32), motion.fps)


def scaled(skeleton: Skeleton, factor: float) -> Skeleton:
    """The rig so many times as large."""
    return turned(Motion.at_rest(skeleton), np.eye(3), factor).skeleton


def axes_of(places: Places, frames: Sequence[Float[Array, "3 3"]] = (np.eye(3),), *, mirrored: bool = False) -> Array:
    """The matrix from the rig's axes to ours (Y up, facing +Z, left +X); for a mirrored rig it has a mirror in it.

    Heads are not exactly above hips. So the body stands and faces along axes of the first of `frames` that has them
    near, or at least stands along one; the columns of a frame are its axes. Without any, it stands as it was measured.
    A rig is mirrored if its toes point back where left is left; `mirrored` says it of a rig without toes.

    Raises:
        MotionError: the hips, the head and the two sides are not in the places of a body's.
    """
    size, hips = length_of(places), (places["leftUpperLeg"] + places["rightUpperLeg"]) / 2
    trunk = places["head"] - hips
    ways = [places[f"left{bone}"] - places[f"right{bone}"] for bone in ("UpperLeg", "UpperArm")]
    across = next((way for way in ways if np.linalg.norm(np.cross(way, _unit(trunk))) > 0.02 * size), None)
    if across is None or not np.linalg.norm(trunk) > 0.1 * size:
        raise MotionError("its rest pose is no body's: head and hips, or left and right, are in one place; pose it")
    ups = [_nearest(frame, trunk) for frame in frames]
    kept = [(frame, up) for frame, up in zip(frames, ups, strict=True) if up @ _unit(trunk) > _LEANING]
    up = kept[0][1] if kept else _unit(trunk)
    left = _level(across, up)
    for frame, along in kept:
        side = _nearest(frame, _level(across, along))
        if side @ _level(across, along) > _TURNED:
            up, left = along, side
            break
    ahead = np.cross(left, up)
    feet = [side for side in ("left", "right") if f"{side}Toes" in places]
    toes = sum(float((places[f"{side}Toes"] - places[f"{side}Foot"]) @ ahead) for side in feet)
    is_mirrored = toes < 0 if abs(toes) > 0.02 * size else mirrored
    return np.stack([left, up, -ahead if is_mirrored else ahead])


def metres_per_unit(places: Places, stated: float | None = None) -> float:
    """The unit that a file states, if the body has a person's size in it.

    Or else a usual one in which it has: an adult's size if there is one, then anyone's. Where none does, the unit that
    makes it as tall as most people.
    """
    tall = _STATURE * length_of(places)
    stages = [((stated,), _ANYONE)] if stated else []
    for units, (low, high) in [*stages, (UNITS, _ADULT), (UNITS, _ANYONE)]:
        for unit in units:
            if low <= unit * tall <= high:
                return unit
    return _MEAN / tall


def length_of(places: Places) -> float:
    """Length of the left leg and of the trunk up to the head along the bones, in the rig's unit, whatever its pose."""
    chain = [places[bone] for bone in ("leftFoot", "leftLowerLeg", "leftUpperLeg")]
    hips = (places["leftUpperLeg"] + places["rightUpperLeg"]) / 2
    ways = [*np.diff(chain, axis=0), places["head"] - hips]
    return float(sum(np.linalg.norm(way) for way in ways))


def _nearest(frame: Float[Array, "3 3"], way: Float[Array, "3"]) -> Float[Array, "3"]:
    """The axis of a frame, to either side, that is nearest to a way."""
    axes = np.concatenate([frame.T, -frame.T])
    nearest: Array = axes[np.argmax(axes @ way)]
    return nearest


def _level(way: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3"]:
    return _unit(way - (way @ up) * up)


def _unit(way: Float[Array, "3"]) -> Float[Array, "3"]:
    unit: Array = way / max(float(np.linalg.norm(way)), 1e-12)
    return unit
