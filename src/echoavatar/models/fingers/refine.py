"""Plausible fingers for whole clips of any rig, length and frame rate (paper, Motion Refinement)."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar.timing import FRAME_RATE_HZ

from .clips import FROZEN_DEG_S, angular_speeds, finger_clip
from .finger_retarget import apply_fingers, finger_joints
from .hand_poses import BONES, SIDES, finger_rotations
from .model import FingerModel
from .sample import STEPS, sample_hands

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

    Raises:
        MotionError: the rig's joint names are unknown.
    """
    rotations, frozen = motion.matrices(), []
    for side in SIDES:
        joints = list(finger_joints(motion, side).values())
        if joints and float(angular_speeds(rotations[:, joints], motion.fps).mean()) < FROZEN_DEG_S:
            frozen.append(side)
    return tuple(frozen)


def smoothed(poses: Float[np.ndarray, "t 2 c"]) -> Float[Tensor, "t 2 c"]:
    """Savitzky-Golay filter over time (paper), with a shorter window on shorter clips."""
    window = min(SMOOTHING_FRAMES, len(poses) - 1 + len(poses) % 2)
    if window <= SMOOTHING_ORDER:
        return torch.from_numpy(poses)
    return torch.from_numpy(savgol_filter(poses, window, SMOOTHING_ORDER, axis=0).astype(np.float32))


def at_rate(poses: Float[Tensor, "t 2 c"], fps: float, frames: int) -> Float[Tensor, "n 2 c"]:
    """Resample poses from 30 frames per second to another rate by cubic splines; the last pose is held."""
    if len(poses) < 2 or (fps == FRAME_RATE_HZ and frames == len(poses)):
        return poses.expand(frames, -1, -1) if len(poses) < 2 else poses
    times = np.minimum(np.arange(frames) * (FRAME_RATE_HZ / fps), len(poses) - 1)
    return torch.from_numpy(CubicSpline(np.arange(len(poses)), poses.numpy())(times).astype(np.float32))


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
