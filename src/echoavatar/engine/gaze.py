"""Eye contact: while the user speaks, head and eyes turn to the viewer. Not in the paper.

The viewer stands on the avatar's +Z side and moves along with it, as the page's camera does. Neck and head take most
of the turn, within the range of a neck, and keep a little of their own movement. The eyes take the rest, through the
look curves of the face. The progress of the turn is stored by chunk number, so a session that goes back continues from
the progress it had there.
"""

import math

import numpy as np
from jaxtyping import Float

from ..face import ARKIT_NAMES
from ..kinematics import Skeleton, lanes
from ..pipeline import MotionChunk
from ..pipeline.action_overlay import Overlay, laid_on
from ..timing import CHUNK, FRAME_RATE_HZ, ChunkSize

RISE_S, FALL_S = 0.5, 0.8  # to eye contact, and out of it
HEAD_SHARE, NECK_SHARE = 0.8, 0.35  # shares of the turn: head and neck together, and the neck alone
FARTHEST = math.radians(55)  # the most that head and neck turn
# A viewer further aside than the first angle is looked at less; one beyond the second, not at all.
WELCOME, BEHIND = math.radians(80), math.radians(140)
LOOK = math.radians(30)  # an eye's turn at a look curve of 1, for our character; 34 degrees in Live Link Face
GLANCES = 0.3  # the share of the eyes' own small movements that stays
KEPT = 64  # chunks whose end is known

_CHAIN = ("hips", "spine", "chest", "upperChest", "neck", "head")
_EYES = [[ARKIT_NAMES.index(f"eyeLook{way}{side}") for side in ("Left", "Right")] for way in ("Up", "Down")]
_LEFTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookOutLeft", "eyeLookInRight")]
_RIGHTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookInLeft", "eyeLookOutRight")]

Quaternions = Float[np.ndarray, "4 t"]


class Gaze:
    """The eye contact of one session."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._frames = chunk.frames
        self._ends: dict[int, float] = {}  # by chunk: progress of the turn at its end, 0 to 1

    def apply(
        self,
        chunk: int,
        motion: MotionChunk,
        skeleton: Skeleton,
        *,
        overlay: Overlay | None = None,
        is_wanted: bool,
    ) -> MotionChunk:
        """Add eye contact if it is wanted, and an action's clip on top. A nod then lowers the head, not the eyes."""
        shares = self.shares(chunk, is_wanted=is_wanted)
        motion = turn_head(motion, shares, skeleton)
        motion = motion if overlay is None else laid_on(motion, overlay, skeleton)
        return turn_eyes(motion, shares, skeleton)

    def shares(self, chunk: int, *, is_wanted: bool) -> Float[np.ndarray, " t"]:
        """Progress of the turn in each frame of a chunk, smoothed, 0 to 1."""
        begin = self._ends.get(chunk - 1, 0.0)
        pace = 1 / (RISE_S * FRAME_RATE_HZ) if is_wanted else -1 / (FALL_S * FRAME_RATE_HZ)
        path = np.clip(begin + pace * np.arange(1, self._frames + 1), 0, 1)
        self._ends[chunk] = float(path[-1])
        for old in [known for known in self._ends if known < chunk - KEPT]:
            del self._ends[old]
        return np.asarray(path**3 * (10 - path * (15 - 6 * path)), np.float32)


def turn_head(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """Turn neck and head to the viewer; a rig without them is left as it is."""
    if not shares.any() or not _has_neck(skeleton):
        return motion
    below, neck, head = _chain(motion, skeleton)
    turn = _to_viewer(lanes.multiply(neck, head))  # rotation vectors in the world
    far = np.sqrt(lanes.dot(turn, turn))
    most = FARTHEST * np.clip((BEHIND - far) / (BEHIND - WELCOME), 0, 1)
    turn = turn * (shares * np.minimum(HEAD_SHARE, most / np.maximum(far, 1e-6)))
    new_neck = lanes.multiply(lanes.quaternion(NECK_SHARE * turn), neck)
    new_head = lanes.multiply(lanes.quaternion(turn), lanes.multiply(neck, head))
    rotations = motion.rotations.copy()
    for name, world, parent in (("neck", new_neck, below), ("head", new_head, new_neck)):
        local = lanes.normalized(lanes.multiply(lanes.conjugate(parent), world))
        rotations[:, skeleton.index(name)] = np.moveaxis(local, 0, -1)
    return motion._replace(rotations=rotations)


def turn_eyes(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """Turn the eyes to the viewer from where the head faces, within the range of eyes."""
    if not shares.any() or motion.face is None or not _has_neck(skeleton):
        return motion
    _, neck, head = _chain(motion, skeleton)
    world = lanes.multiply(neck, head)
    viewer = _rotated(lanes.conjugate(world), np.array([0, 0, 1], np.float32))  # in the head's frame
    is_ahead = np.clip((BEHIND - np.arccos(np.clip(viewer[2], -1, 1))) / (BEHIND - WELCOME), 0, 1)
    yaw = np.clip(np.arctan2(viewer[0], np.maximum(viewer[2], 1e-6)) / LOOK, -1, 1) * is_ahead
    pitch = np.clip(np.arcsin(np.clip(viewer[1], -1, 1)) / LOOK, -1, 1) * is_ahead
    face, own = motion.face.copy(), (1 - (1 - GLANCES) * shares)[:, None]
    for columns, value in (
        (_LEFTWARDS, yaw),
        (_RIGHTWARDS, -yaw),
        (_EYES[0], pitch),
        (_EYES[1], -pitch),
    ):
        face[:, columns] = np.clip(face[:, columns] * own + (shares * np.maximum(value, 0))[:, None], 0, 1)
    return motion._replace(face=face)


def off_viewer(motion: MotionChunk, skeleton: Skeleton) -> Float[np.ndarray, " t"]:
    """Angle between the head's direction and the viewer, in radians."""
    _, neck, head = _chain(motion, skeleton)
    turn = _to_viewer(lanes.multiply(neck, head))
    return np.asarray(np.sqrt(lanes.dot(turn, turn)))


def _has_neck(skeleton: Skeleton) -> bool:
    return {"neck", "head"} <= set(skeleton.names)


def _chain(motion: MotionChunk, skeleton: Skeleton) -> tuple[Quaternions, Quaternions, Quaternions]:
    """World rotations of the neck's parent and the neck; and the head relative to the neck."""
    local = {
        name: np.moveaxis(motion.rotations[:, skeleton.index(name)], -1, 0)
        for name in _CHAIN
        if name in skeleton.names
    }
    head, neck = local.pop("head"), local.pop("neck")
    below = np.zeros_like(neck)
    below[0] = 1
    for rotation in local.values():
        below = lanes.multiply(below, rotation)
    return below, lanes.multiply(below, neck), head


def _to_viewer(world: Quaternions) -> Float[np.ndarray, "3 t"]:
    """Rotation vector of the shortest turn from the rotated +Z axis to the world's +Z."""
    ahead = _rotated(world, np.array([0, 0, 1], np.float32))
    axis = np.stack([ahead[1], -ahead[0], np.zeros_like(ahead[0])])  # ahead x (0, 0, 1)
    sine = np.sqrt(lanes.dot(axis, axis))
    angle = np.arctan2(sine, ahead[2])
    return np.asarray(axis * (angle / np.maximum(sine, 1e-6)), np.float32)


def _rotated(rotation: Quaternions, vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 t"]:
    """A vector, rotated."""
    pure = np.zeros_like(rotation)
    pure[1:] = vector[:, None]
    return lanes.multiply(lanes.multiply(rotation, pure), lanes.conjugate(rotation))[1:]
