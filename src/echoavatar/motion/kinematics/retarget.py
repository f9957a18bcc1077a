"""Retarget motion to a rig with other bones, proportions and rest pose.

Each bone gets the world rotation of its counterpart, corrected for the difference of the rest poses (`alignment`). A
bone without a counterpart rests on its parent; a spine bone without one gets half the rotation between its neighbours.

`retarget` measures on the whole clip: the hips travel in proportion to leg length, then planted feet are put on the
floor and kept still (`foot_planting`). `LiveRetarget` takes each frame by itself and measures on the two rest poses,
which must stand upright; the stages behind the decoder correct its feet.
"""

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError

from .alignment import align, has_rest_pose, leg_length, rest_turns
from .foot_planting import foot_contacts, settle_feet, sliding
from .motion import Motion, Pose, forward_kinematics
from .rigs import bone_map, feet_of, known_bones
from .rotations import matrix_from_quaternion, quaternion_from_matrix, slerp
from .skeleton import HUMANOID, Skeleton

Array = np.ndarray
_log = logging.getLogger(__name__)
_LEG = leg_length(HUMANOID, HUMANOID.config.vrm)
_WORSE, _SEEN = 1.25, 1.0  # a warning comes above this factor of the source's skating plus these cm/s


def retarget(motion: Motion, target: Skeleton = HUMANOID, *, has_footing: bool = True) -> Motion:
    """The motion on the target rig, in metres, with the floor at y = 0.

    Args:
        motion: on any rig with known bones.
        target: the rig to retarget to; its rest pose must stand upright.
        has_footing: whether planted feet are kept still by leg IK; False retargets rotations and root alone.

    Raises:
        MotionError: the joint names of the source are not known.
    """
    motion = with_wrists(motion)
    source, theirs, ours = motion.skeleton, bone_map(motion.skeleton), bone_map(target)
    pose = motion.pose(np.float64)
    world = {
        ours[bone]: pose.rotations[:, theirs[bone]] @ rotation
        for bone, rotation in align(source, pose, theirs, target, ours).items()
    }
    local = local_rotations(target, world, motion.frames)
    root = _root(motion, pose, theirs, target, ours, local)
    moved = Motion(target, quaternion_from_matrix(local).astype(np.float32), root.astype(np.float32), motion.fps)
    if not has_footing:
        return moved
    sizes = [leg_length(rig, bones) / _LEG for rig, bones in ((source, theirs), (target, ours))]
    contacts = foot_contacts(motion, size=sizes[0])
    contacts |= foot_contacts(moved, stands_on_rest=True, size=min(1.0, sizes[1]))
    settled = settle_feet(moved, contacts)
    before, after = (_skate(clip, size) for clip, size in zip((motion, settled), sizes, strict=True))
    if after > _WORSE * before + _SEEN:
        _log.warning("planted feet slide at %.1f cm/s on this body, and at %.1f in the recording", after, before)
    return settled


def _skate(motion: Motion, size: float) -> float:
    """Mean speed of planted toes, cm/s on a body of our rig's size."""
    places = motion.pose().positions[:, feet_of(bone_map(motion.skeleton))[1::2]] / size
    return 100 * sliding(places, motion.fps)


class PlainRig(NamedTuple):
    """A rig in our rest pose: arms stretched to the sides, legs down, feet flat, whatever pose its file has at rest.

    `of_own` and `to_own` convert motion between its two rest poses; every joint keeps its place.
    """

    skeleton: Skeleton
    turns: Float[np.ndarray, "j 3 3"]  # of each joint in the world, from this rest pose to the rig's own

    def of_own(self, motion: Motion) -> Motion:
        """The motion relative to this rest pose."""
        above = self._above()
        return _posed(motion, self.skeleton, above.mT @ motion.matrices().astype(np.float64) @ self.turns)

    def to_own(self, motion: Motion, own: Skeleton) -> Motion:
        """The motion relative to the rest pose of the rig itself."""
        return _posed(motion, own, self._above() @ motion.matrices().astype(np.float64) @ self.turns.mT)

    def _above(self) -> Array:
        parents = list(self.skeleton.parents)
        return np.concatenate([np.eye(3)[None], self.turns[parents[1:]]])


def _posed(motion: Motion, skeleton: Skeleton, rotations: Array) -> Motion:
    return Motion(skeleton, quaternion_from_matrix(rotations).astype(np.float32), motion.root, motion.fps)


def plain_rig(skeleton: Skeleton) -> PlainRig:
    """The rig in our rest pose, with its own bone lengths and its hips where they are.

    Raises MotionError if the rig's bones are not known.
    """
    bones, config = bone_map(skeleton), skeleton.config
    found, named = rest_turns(skeleton, bones), {joint: bone for bone, joint in bones.items()}
    turns: list[Array] = []
    for joint, parent in enumerate(skeleton.parents):
        above = turns[parent] if parent >= 0 else found["hips"]
        turns.append(found[named[joint]] if joint in named else above)
    offsets = [
        offset if parent < 0 else turns[parent].T @ offset
        for parent, offset in zip(skeleton.parents, skeleton.offsets.astype(np.float64), strict=True)
    ]
    tips = {name: turns[skeleton.index(name)].T @ np.array(tip) for name, tip in config.tips.items()}
    return PlainRig(skeleton.with_offsets(offsets, tips), np.stack(turns))


def with_wrists(motion: Motion) -> Motion:
    """The same motion with hands at the tips of the lower arms, if its rig is known and has no hands."""
    bones, config = known_bones(motion.skeleton), motion.skeleton.config
    arms = {side: bones.get(f"{side}LowerArm", -1) for side in ("left", "right") if f"{side}Hand" not in bones}
    arms = {side: arm for side, arm in arms.items() if arm >= 0 and config.names[arm] in config.tips}
    if not arms:
        return motion
    hands = {f"{side}Hand": len(config.names) + number for number, side in enumerate(arms)}
    longer = config.model_copy(
        update={
            "names": (*config.names, *hands),
            "parents": (*config.parents, *arms.values()),
            "offsets": (*config.offsets, *(config.tips[config.names[arm]] for arm in arms.values())),
            "vrm": bones | hands,
        }
    )
    still = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), (motion.frames, len(arms), 4))
    return Motion(Skeleton(longer), np.concatenate([motion.rotations, still], 1), motion.root, motion.fps)


def local_rotations(target: Skeleton, world: dict[int, Array], frames: int) -> Array:
    """Parent-relative rotations from world rotations of some joints.

    A joint without a world rotation rests on its parent: in a limb, where it carries twist, anything else would bend
    the bone. Between two joints of trunk and neck it gets half the rotation.
    """
    bones = bone_map(target)
    trunk = {bones[bone] for bone in ("spine", "chest", "upperChest", "neck", "head") if bone in bones}
    full: list[Array] = []
    eye = np.tile(np.eye(3), (frames, 1, 1))
    for joint, parent in enumerate(target.parents):
        if joint in world:
            full.append(world[joint])
            continue
        above = full[parent] if parent >= 0 else eye
        below = [j for j in world if target.parents[j] == joint]
        if len(below) == 1 and below[0] in trunk and parent in world:
            both = [quaternion_from_matrix(rotation) for rotation in (above, world[below[0]])]
            above = matrix_from_quaternion(slerp(both[0], both[1], 0.5))
        full.append(above)
    local = [
        rotation if parent < 0 else full[parent].mT @ rotation
        for rotation, parent in zip(full, target.parents, strict=True)
    ]
    return np.stack(local, 1)


def _root(
    motion: Motion, pose: Pose, theirs: Mapping[str, int], target: Skeleton, ours: Mapping[str, int], local: Array
) -> Array:
    """Root positions that move the midpoint of the hip joints as the source's, scaled, with the feet on the floor."""
    scale = leg_length(target, ours) / leg_length(motion.skeleton, theirs)
    legs = ("leftUpperLeg", "rightUpperLeg")
    middle = pose.positions[:, [theirs[leg] for leg in legs]].mean(1) * scale
    placed = forward_kinematics(target, local, np.zeros((motion.frames, 3))).positions
    root: Array = middle - placed[:, [ours[leg] for leg in legs]].mean(1)
    feet = [ours[name] for name in ("leftFoot", "rightFoot")]
    standing = np.quantile((placed[:, feet, 1] + root[:, None, 1]).min(1), 0.1)
    ankle = float(target.rest_positions[feet, 1].mean())
    root[:, 1] += ankle - standing
    return root


class Retargeted(NamedTuple):
    """Frames on the target rig. The target's root is `scale` times the source's plus `offset`, metres."""

    rotations: Float[np.ndarray, "n j 3 3"]
    offset: Float[np.ndarray, "n 3"]


class LiveRetarget:
    """Retargets from one rig to another, each frame by itself."""

    def __init__(self, source: Skeleton, target: Skeleton = HUMANOID) -> None:
        """Both rigs in metres, Y up, facing +Z.

        Raises MotionError if the source's bones are not known, or its rest pose does not stand upright.
        """
        theirs, ours = bone_map(source), bone_map(target)
        rest = source.rest_positions
        if not has_rest_pose(source, theirs):
            raise MotionError("the rest pose of the rig does not stand upright (Y up, metres); rotate it first")
        self.source, self.target = source, target
        self.scale = leg_length(target, ours) / leg_length(source, theirs)
        still = np.tile(np.eye(3), (1, source.joints, 1, 1))
        pose = forward_kinematics(source, still, rest[:1].astype(np.float64))
        found = align(source, pose, theirs, target, ours)
        self._rotations = {ours[bone]: (theirs[bone], rotation.astype(np.float32)) for bone, rotation in found.items()}
        legs, feet = ("leftUpperLeg", "rightUpperLeg"), ("leftFoot", "rightFoot")
        self._their_legs, self._our_legs = ([bones[leg] for leg in legs] for bones in (theirs, ours))
        ankles = [ours[foot] for foot in feet]
        self._floor = 0.0
        moved = self(still.astype(np.float32))
        standing = forward_kinematics(target, moved.rotations, self.scale * rest[:1] + moved.offset)
        self._floor = float(target.rest_positions[ankles, 1].mean() - standing.positions[0, ankles, 1].min())

    def __call__(self, rotations: Float[np.ndarray, "n j 3 3"]) -> Retargeted:
        """Retarget parent-relative rotations of the source."""
        nowhere = np.zeros((len(rotations), 3), rotations.dtype)
        pose = forward_kinematics(self.source, rotations, nowhere)
        world = {joint: pose.rotations[:, bone] @ rotation for joint, (bone, rotation) in self._rotations.items()}
        local = local_rotations(self.target, world, len(rotations)).astype(rotations.dtype)
        middle = pose.positions[:, self._their_legs].mean(1) * self.scale
        placed = forward_kinematics(self.target, local, nowhere).positions[:, self._our_legs].mean(1)
        return Retargeted(local, middle - placed + np.array([0, self._floor, 0], rotations.dtype))
