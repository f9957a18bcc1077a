"""Eye contact: while the user speaks, head and eyes turn to the viewer. Not in the paper.

The viewer stands on the avatar's +Z side and moves along with it, as the page's camera does. Neck and head make most
of the rotation, within the range of a neck, and keep a little of their own movement. The eyes make the rest, through
the look curves of the face.
"""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.timing import CHUNK, ChunkSize

from .action_overlay import Overlay, apply_overlay
from .arkit import ARKIT_NAMES
from .kinematics import Skeleton
from .kinematics.easing import smootherstep
from .kinematics.rotations import matrix_from_axis_angle, matrix_from_quaternion, quaternion_from_matrix
from .motion_chunk import ChunkFade, MotionChunk

RISE_S, FALL_S = 0.5, 0.8  # to eye contact, and out of it
HEAD_SHARE, NECK_SHARE = 0.8, 0.35  # of the rotation: head and neck together; of that, the neck alone
FARTHEST = math.radians(55)  # the largest rotation of head and neck together
# Beyond the first angle the avatar looks at the viewer less; beyond the second, not at all.
WELCOME, BEHIND = math.radians(80), math.radians(140)
LOOK = math.radians(30)  # how far an eye of our character rotates at a look curve of 1; 34 degrees in Live Link Face
GLANCES = 0.3  # the share of the eyes' own small movements that stays

_CHAIN = ("hips", "spine", "chest", "upperChest", "neck", "head")
_EYES = [[ARKIT_NAMES.index(f"eyeLook{way}{side}") for side in ("Left", "Right")] for way in ("Up", "Down")]
_LEFTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookOutLeft", "eyeLookInRight")]
_RIGHTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookInLeft", "eyeLookOutRight")]


class Gaze:
    """The eye contact of one session."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._fade = ChunkFade(RISE_S, FALL_S, chunk=chunk)

    def apply(
        self, chunk: int, motion: MotionChunk, skeleton: Skeleton, *, overlay: Overlay | None = None, is_wanted: bool
    ) -> MotionChunk:
        """Add eye contact if it is wanted, and an action's overlay on top. A nod then lowers the head, not the eyes."""
        shares = self.shares(chunk, is_wanted=is_wanted)
        motion = turn_head(motion, shares, skeleton)
        motion = motion if overlay is None else apply_overlay(motion, overlay, skeleton)
        return turn_eyes(motion, shares, skeleton)

    def shares(self, chunk: int, *, is_wanted: bool) -> Float[np.ndarray, " t"]:
        """How far eye contact has come in each frame of a chunk, smoothed, 0 to 1."""
        return smootherstep(self._fade.shares(chunk, is_wanted=is_wanted)).astype(np.float32)


def turn_head(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """Turn neck and head to the viewer; a rig without them is left as it is."""
    if not shares.any() or not _has_neck(skeleton):
        return motion
    below, neck, head = _chain(motion, skeleton)
    rotation = _to_viewer(head)
    angle = rotation.norm(dim=-1)
    largest = FARTHEST * ((BEHIND - angle) / (BEHIND - WELCOME)).clamp(0, 1)
    rotation *= (torch.from_numpy(shares) * (largest / angle.clamp_min(1e-6)).clamp_max(HEAD_SHARE))[:, None]
    both = torch.stack([NECK_SHARE * rotation, rotation], 1)
    new = matrix_from_axis_angle(both) @ torch.stack([neck, head], 1)
    parents = torch.stack([below, new[:, 0]], 1)
    rotations = motion.rotations.copy()
    rotations[:, skeleton.indices(["neck", "head"])] = quaternion_from_matrix(parents.mT @ new).numpy()
    return motion._replace(rotations=rotations)


def turn_eyes(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """Turn the eyes to the viewer from where the head faces, within the range of eyes."""
    if not shares.any() or motion.face is None or not _has_neck(skeleton):
        return motion
    viewer = _chain(motion, skeleton)[2][:, 2].numpy().T  # the direction of the world's +Z in the head's axes
    is_ahead = np.clip((BEHIND - np.arccos(np.clip(viewer[2], -1, 1))) / (BEHIND - WELCOME), 0, 1)
    yaw = np.clip(np.arctan2(viewer[0], np.maximum(viewer[2], 1e-6)) / LOOK, -1, 1) * is_ahead
    pitch = np.clip(np.arcsin(np.clip(viewer[1], -1, 1)) / LOOK, -1, 1) * is_ahead
    face, own = motion.face.copy(), (1 - (1 - GLANCES) * shares)[:, None]
    for columns, value in ((_LEFTWARDS, yaw), (_RIGHTWARDS, -yaw), (_EYES[0], pitch), (_EYES[1], -pitch)):
        face[:, columns] = np.clip(face[:, columns] * own + (shares * np.maximum(value, 0))[:, None], 0, 1)
    return motion._replace(face=face)


def _has_neck(skeleton: Skeleton) -> bool:
    return {"neck", "head"} <= set(skeleton.names)


def _chain(
    motion: MotionChunk, skeleton: Skeleton
) -> tuple[Float[Tensor, "t 3 3"], Float[Tensor, "t 3 3"], Float[Tensor, "t 3 3"]]:
    """World rotations of the neck's parent, the neck and the head; only the spine is multiplied out."""
    joints = skeleton.indices([name for name in _CHAIN if name in skeleton.names])
    world = [torch.eye(3).expand(len(motion.rotations), 3, 3)]
    for local in matrix_from_quaternion(torch.tensor(motion.rotations[:, joints], dtype=torch.float32)).unbind(1):
        world.append(world[-1] @ local)
    return world[-3], world[-2], world[-1]


def _to_viewer(world: Float[Tensor, "t 3 3"]) -> Float[Tensor, "t 3"]:
    """The rotation vector, in world axes, that takes each frame's own +Z to the world's +Z."""
    x, y, z = world[:, :, 2].unbind(-1)
    axis = torch.stack([y, -x, torch.zeros_like(x)], -1)  # (x, y, z) x (0, 0, 1)
    sine = torch.hypot(x, y)
    return axis * (torch.atan2(sine, z) / sine.clamp_min(1e-6))[:, None]
