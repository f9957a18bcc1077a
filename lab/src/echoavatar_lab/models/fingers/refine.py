"""Plausible fingers for whole clips of any rig, length and frame rate (paper, Motion Refinement).

Fingers go from our rig to the hands of any other by inverse retargeting. Retargeting gives our bone the world rotation
of its counterpart times a constant A (`kinematics.alignment`). Here the counterpart gets our rotation times the inverse
of A, relative to its own hand. Joints that our rig lacks, such as metacarpals, keep their rotations, and so does the
body.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.alignment import align
from echoavatar.motion.kinematics.named_bones import finger_bones
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.models.fingers.clips import (
    BONES,
    FINGERS,
    FROZEN_DEG_S,
    SIDES,
    angular_speeds,
    finger_clip,
    finger_rotations,
)
from echoavatar_lab.models.fingers.model import STEPS, FingerModel, sample_hands

Array = np.ndarray


def finger_joints(motion: Motion, side: str) -> dict[str, int]:
    """Map VRM names to joints, for the finger bones of one hand that the rig has.

    Raises MotionError if the rig's joint names are unknown.
    """
    bones = bone_map(motion.skeleton)
    named = (bone for digit in finger_bones(side).values() for bone in digit)
    return {bone: bones[bone] for bone in named if bone in bones}


def apply_fingers(motion: Motion, fingers: Float[Array, "t 30 3 3"], sides: Sequence[str]) -> Motion:
    """The motion with these fingers (parent-relative rotations of our rig) on the hands of `sides`."""
    bones, ours = bone_map(motion.skeleton), bone_map(HUMANOID)
    local = motion.matrices().astype(np.float64)
    alignments = align(motion.skeleton, motion.pose(np.float64), bones, HUMANOID, ours)
    rotations = motion.rotations.copy()
    for side in sides:
        wanted = _from_the_hand(fingers.astype(np.float64), alignments, side)
        found = {joint: wanted[bone] for bone, joint in finger_joints(motion, side).items()}
        for joint, rotation in _localised(motion, local, bones[f"{side}Hand"], found).items():
            rotations[:, joint] = quaternion_from_matrix(rotation)
    return replace(motion, rotations=rotations)


def _from_the_hand(fingers: Array, alignments: dict[str, Array], side: str) -> dict[str, Array]:
    """Rotation of each finger bone of the other rig, relative to its hand."""
    found: dict[str, Array] = {}
    full = {HUMANOID.index(f"{side}Hand"): alignments[f"{side}Hand"]}
    for row, joint in enumerate(FINGERS):
        name = HUMANOID.names[joint]
        if not name.startswith(side):
            continue
        full[joint] = full[HUMANOID.parents[joint]] @ fingers[:, row]
        if name in alignments:
            found[name] = full[joint] @ alignments[name].T
    return found


def _localised(motion: Motion, local: Array, hand: int, wanted: dict[int, Array]) -> dict[int, Array]:
    """Parent-relative rotations of the wanted joints, from the hand downwards."""
    full = {hand: np.tile(np.eye(3), (motion.frames, 1, 1))}
    found: dict[int, Array] = {}
    for joint in range(hand + 1, motion.skeleton.joints):
        above = full.get(motion.skeleton.parents[joint])
        if above is None:
            continue
        if joint in wanted:
            full[joint] = wanted[joint]
            found[joint] = above.mT @ wanted[joint]
        else:
            full[joint] = above @ local[:, joint]
    return found


Hands = Literal["both", "left", "right", "frozen"]
SMOOTHING_FRAMES, SMOOTHING_ORDER = 9, 2  # Savitzky-Golay, 0.3 s


def refine_fingers(
    model: FingerModel,
    motion: Motion,
    *,
    hands: Hands = "both",
    seed: int = 0,
    steps: int = STEPS,
    progress: Callable[[int, int], None] | None = None,
) -> Motion:
    """The same motion with new fingers on one or both hands; nothing else changes.

    If a kept hand moves its fingers, the model sees it, so that the new hand fits it.

    Args:
        model: a trained finger model.
        motion: on any rig with known joint names and finger bones; some bones may be missing.
        hands: which hands get new fingers; "frozen": those whose fingers do not move, if any.
        seed: of the noise; another seed gives other fingers.
        steps: of denoising; 1 gives the mean of all plausible fingers.
        progress: called with (steps done, steps).

    Raises:
        MotionError: the rig is unknown, or lacks the requested fingers.
    """
    sides = _sides(motion, hands)
    if not sides:
        return motion
    clip = finger_clip(motion)
    known = model.basis.encode(clip.hands)
    is_shown = [side not in sides and len(finger_joints(motion, side)) == BONES for side in SIDES]
    is_known = (torch.tensor(is_shown) & clip.is_moving).expand(len(known), 2)
    coordinates = sample_hands(model, clip.body, known, is_known, seed=seed, steps=steps, progress=progress)
    poses = smoothed(model.basis.decode(coordinates).numpy())
    return apply_fingers(motion, finger_rotations(at_rate(poses, motion.fps, motion.frames)), sides)


def frozen_hands(motion: Motion) -> tuple[str, ...]:
    """The sides whose finger bones do not move (mean speed under 1 degree per second).

    Raises MotionError if the rig's joint names are unknown.
    """
    rotations, frozen = motion.matrices(), []
    for side in SIDES:
        joints = list(finger_joints(motion, side).values())
        if joints and float(angular_speeds(rotations[:, joints], motion.fps).mean()) < FROZEN_DEG_S:
            frozen.append(side)
    return tuple(frozen)


def smoothed(poses: Float[Array, "t 2 c"]) -> Float[Array, "t 2 c"]:
    """Savitzky-Golay filter over time (paper), with a shorter window on shorter clips."""
    window = min(SMOOTHING_FRAMES, len(poses) - 1 + len(poses) % 2)
    if window <= SMOOTHING_ORDER:
        return poses
    return np.asarray(savgol_filter(poses, window, SMOOTHING_ORDER, axis=0), np.float32)


def at_rate(poses: Float[Array, "t 2 c"], fps: float, frames: int) -> Float[Array, "n 2 c"]:
    """Resample poses from 30 frames per second to another rate by cubic splines; the last pose is held."""
    if len(poses) < 2 or (fps == FRAME_RATE_HZ and frames == len(poses)):
        return np.repeat(poses, frames, axis=0) if len(poses) < 2 else poses
    times = np.minimum(np.arange(frames) * (FRAME_RATE_HZ / fps), len(poses) - 1)
    return np.asarray(CubicSpline(np.arange(len(poses)), poses)(times), np.float32)


def _sides(motion: Motion, hands: Hands) -> tuple[str, ...]:
    """The sides that get new fingers."""
    there = [side for side in SIDES if finger_joints(motion, side)]
    wanted = [hands] if hands in SIDES else there
    if not there or wanted[0] not in there:
        which = f"no fingers on its {hands} hand" if there else "no finger bones whose names are known"
        raise MotionError(
            f"the rig with joints {', '.join(motion.skeleton.names[:3])}, ... has {which}; bring the motion to a rig"
            " with fingers first"
        )
    return frozen_hands(motion) if hands == "frozen" else tuple(wanted)
