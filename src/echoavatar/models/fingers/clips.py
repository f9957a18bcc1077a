"""Clips as the finger model sees them: body features, both hands, and which hands move."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between
from echoavatar.timing import FRAME_RATE_HZ

from .body_features import body_features
from .hand_poses import BONES, FINGERS, hand_poses

FROZEN_DEG_S = 1.0  # fingers with a lower mean speed were not captured


class FingerClip(NamedTuple):
    """A clip on our rig at 30 frames per second."""

    body: Float[Tensor, "t c"]
    hands: Float[Tensor, "t 2 d"]  # left, and right mirrored (`hand_poses`)
    is_moving: Bool[Tensor, " 2"]  # whose fingers move


def finger_clip(motion: Motion, *, at_least: int = 1) -> FingerClip:
    """Features of a motion of any rig; a shorter motion plays back and forth until it has `at_least` frames.

    Raises:
        MotionError: the rig's joint names are unknown.
    """
    own = on_our_rig(motion)
    back_and_forth = np.arange(max(own.frames, at_least)) % max(1, 2 * own.frames - 2)
    at = np.minimum(back_and_forth, 2 * own.frames - 2 - back_and_forth)
    own = replace(own, rotations=own.rotations[at], root=own.root[at])
    rotations = own.matrices()
    fingers = rotations[:, list(FINGERS)]
    body = body_features(rotations, torch.from_numpy(own.root))
    speeds = angular_speeds(fingers, FRAME_RATE_HZ).reshape(2, BONES).mean(1)
    return FingerClip(body, hand_poses(fingers), speeds > FROZEN_DEG_S)


def on_our_rig(motion: Motion) -> Motion:
    """The motion on `HUMANOID` at 30 frames per second; feet are not corrected, because the model ignores them."""
    is_ours = motion.skeleton.names == HUMANOID.names
    return resample(motion if is_ours else retarget(motion, has_footing=False), float(FRAME_RATE_HZ))


def angular_speeds(rotations: Float[Tensor, "t j 3 3"], fps: float) -> Float[Tensor, " j"]:
    """Mean angular speed of each joint, degrees per second; 0 for a single frame."""
    if len(rotations) < 2:
        return torch.zeros(rotations.shape[1])
    return torch.rad2deg(angle_between(rotations[:-1], rotations[1:])).mean(0) * fps
