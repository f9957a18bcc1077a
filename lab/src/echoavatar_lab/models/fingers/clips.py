"""Clips as the finger model sees them: body features, both hands, and which hands move.

Body features (paper: "the remaining body joints") do not depend on heading. For each hand, in axes at the hips that
face +Z: the wrist's position (metres) and velocity (metres per second), the hand's orientation (6D) and the direction
of the forearm; then the hips' velocity forward and to the left, and their height. Joint rotations are left out, because
they identify rig and person, which prevents generalisation.

Hand poses are 15 finger bones in 6D, the right hand mirrored. A hand has 90 numbers but far fewer degrees of freedom.
The model works on coordinates along the principal directions of good hands, so every output is close to a pose that
hands take.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID, Motion, forward_kinematics
from echoavatar.motion.kinematics.motion import resample
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_6d, matrix_to_6d, unit
from echoavatar.timing import FRAME_RATE_HZ

Array = np.ndarray
FINGERS = HUMANOID.config.parts["hands"]  # 15 joints of the left hand, 15 of the right
BONES = len(FINGERS) // 2
HAND_SIZE = 6 * BONES
SIDES = ("left", "right")
MIRROR_6D = (1.0, -1.0, -1.0, -1.0, 1.0, 1.0)  # reflection across x = 0
_SIGNS = np.array([(1.0,) * 6, MIRROR_6D], np.float32)[:, None]


def hand_poses(fingers: Float[Array, "*n 30 3 3"]) -> Float[Array, "*n 2 c"]:
    """Left hand, and right hand mirrored, from finger rotations in the order of the rig."""
    six = matrix_to_6d(fingers).reshape(*fingers.shape[:-3], 2, BONES, 6)
    poses: Array = (six * _SIGNS).reshape(*six.shape[:-2], HAND_SIZE)
    return poses


def finger_rotations(hands: Float[Array, "*n 2 c"]) -> Float[Array, "*n 30 3 3"]:
    """Inverse of `hand_poses`; any finite numbers give valid rotations."""
    six = hands.reshape(*hands.shape[:-1], BONES, 6)
    return matrix_from_6d((six * _SIGNS).reshape(*six.shape[:-3], 2 * BONES, 6))


class HandBasis(NamedTuple):
    """Principal directions of hand poses; the mean variance of the coordinates is 1."""

    mean: Float[Tensor, " c"]
    axes: Float[Tensor, "k c"]
    scale: Float[Tensor, " k"]

    @property
    def spread(self) -> Float[Tensor, " k"]:
        """Standard deviation of each coordinate over the hands it was fitted to."""
        return self.scale / self.scale.square().mean().sqrt()

    def encode(self, hands: Float[Tensor, "*n c"]) -> Float[Tensor, "*n k"]:
        """Coordinates of poses."""
        return (hands - self.mean) @ self.axes.T / self.scale

    def decode(self, coordinates: Float[Tensor, "*n k"]) -> Float[Tensor, "*n c"]:
        """Poses, without the part in the directions left out."""
        return (coordinates * self.scale) @ self.axes + self.mean


_WRISTS = HUMANOID.indices(("leftHand", "rightHand"))
_ELBOWS = HUMANOID.indices(("leftLowerArm", "rightLowerArm"))
HAND_FEATURES = 3 + 3 + 6 + 3
BODY_SIZE = 2 * HAND_FEATURES + 3


def body_features(rotations: Float[Array, "t 52 3 3"], root: Float[Array, "t 3"]) -> Float[Array, "t c"]:
    """Features of a clip of `HUMANOID` at 30 frames per second; they do not depend on the fingers."""
    flat_handed = rotations.copy()
    flat_handed[:, list(FINGERS)] = np.eye(3)
    pose = forward_kinematics(HUMANOID, flat_handed, root)
    back = _heading(pose.rotations[:, 0]).mT
    wrists = (back[:, None] @ (pose.positions[:, _WRISTS] - root[:, None])[..., None])[..., 0]
    elbows = (back[:, None] @ (pose.positions[:, _ELBOWS] - root[:, None])[..., None])[..., 0]
    palms = matrix_to_6d(back[:, None] @ pose.rotations[:, _WRISTS])
    hands = np.concatenate([wrists, _velocity(wrists), palms, unit(wrists - elbows)], -1)
    travel = (back @ _velocity(root)[..., None])[..., 0]
    return np.concatenate([hands.reshape(len(hands), -1), travel[:, [2, 0]], root[:, 1:2]], -1)


def _heading(hips: Float[Array, "t 3 3"]) -> Float[Array, "t 3 3"]:
    """Rotation about the vertical that takes +X to the character's left."""
    x, z = hips[:, 0, 0], hips[:, 2, 0]
    length = np.maximum(np.hypot(x, z), 1e-6)
    cosine, sine, zero, one = x / length, z / length, np.zeros_like(x), np.ones_like(x)
    rows = [cosine, zero, -sine, zero, one, zero, sine, zero, cosine]
    return np.stack(rows, -1).reshape(-1, 3, 3)


def _velocity(places: Array) -> Array:
    """Velocity per second by central differences; zero for a single frame."""
    if len(places) < 2:
        return np.zeros_like(places)
    speed: Array = np.gradient(places, 1 / FRAME_RATE_HZ, axis=0)
    return speed


FROZEN_DEG_S = 1.0  # fingers with a lower mean speed were not captured


class FingerClip(NamedTuple):
    """A clip on our rig at 30 frames per second."""

    body: Float[Tensor, "t c"]
    hands: Float[Tensor, "t 2 d"]  # left, and right mirrored (`hand_poses`)
    is_moving: Bool[Tensor, " 2"]  # whether each hand's fingers move


def finger_clip(motion: Motion, *, at_least: int = 1) -> FingerClip:
    """Features of a motion of any rig; a shorter motion plays back and forth until it has `at_least` frames.

    Raises MotionError if the rig's joint names are unknown.
    """
    own = on_our_rig(motion)
    back_and_forth = np.arange(max(own.frames, at_least)) % max(1, 2 * own.frames - 2)
    at = np.minimum(back_and_forth, 2 * own.frames - 2 - back_and_forth)
    own = replace(own, rotations=own.rotations[at], root=own.root[at])
    rotations = own.matrices()
    fingers = rotations[:, list(FINGERS)]
    speeds = angular_speeds(fingers, FRAME_RATE_HZ).reshape(2, BONES).mean(1)
    body, hands = body_features(rotations, own.root), hand_poses(fingers)
    return FingerClip(*(torch.from_numpy(part) for part in (body, hands, speeds > FROZEN_DEG_S)))


def on_our_rig(motion: Motion) -> Motion:
    """The motion on `HUMANOID` at 30 frames per second; feet are not corrected, because the model ignores them."""
    is_ours = motion.skeleton.names == HUMANOID.names
    return resample(motion if is_ours else retarget(motion, has_footing=False), float(FRAME_RATE_HZ))


def angular_speeds(rotations: Float[Array, "t j 3 3"], fps: float) -> Float[Array, " j"]:
    """Mean angular speed of each joint, degrees per second; 0 for a single frame."""
    if len(rotations) < 2:
        return np.zeros(rotations.shape[1], np.float32)
    speeds: Array = np.degrees(angle_between(rotations[:-1], rotations[1:])).mean(0) * fps
    return speeds
