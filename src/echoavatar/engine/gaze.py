"""Eye contact: while the user speaks, head and eyes turn to the viewer. Not in the paper.

The viewer stands in front of where the avatar faced at first (+Z), wherever it went: the page's camera goes along with
it. Neck and head take most of the turn, as far as a neck goes, and keep a little of their own movement; the eyes do
what is left of it, through the look curves of the face. How far the turn has come is known for each chunk by its
number, so a session that is taken back goes on from where it was.
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
HEAD_SHARE, NECK_SHARE = 0.8, 0.35  # of the turn: by head and neck together, and by the neck alone
FARTHEST = math.radians(55)  # that head and neck turn for it
WELCOME, BEHIND = (
    math.radians(80),
    math.radians(140),
)  # who stands further aside is looked at less; behind, not at all
LOOK = math.radians(30)  # an eye's turn at a look curve of 1, as our character has it; Live Link Face: 34
GLANCES = 0.3  # of the eyes' own small movements, what is kept
KEPT = 64  # chunks whose end is known

_CHAIN = ("hips", "spine", "chest", "upperChest", "neck", "head")
_EYES = [[ARKIT_NAMES.index(f"eyeLook{way}{side}") for side in ("Left", "Right")] for way in ("Up", "Down")]
_LEFTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookOutLeft", "eyeLookInRight")]
_RIGHTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookInLeft", "eyeLookOutRight")]

Quaternions = Float[np.ndarray, "4 t"]


class Gaze:
    """One session's."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._frames = chunk.frames
        self._ends: dict[int, float] = {}  # by chunk: how far the turn had come at its end, 0 to 1

    def turned(
        self,
        chunk: int,
        motion: MotionChunk,
        skeleton: Skeleton,
        *,
        overlay: Overlay | None = None,
        is_wanted: bool,
    ) -> MotionChunk:
        """A chunk with eye contact where it is wanted, and an action's turns on top: a nod lowers only the head."""
        shares = self.shares(chunk, is_wanted=is_wanted)
        motion = head_turned(motion, shares, skeleton)
        motion = motion if overlay is None else laid_on(motion, overlay, skeleton)
        return eyes_turned(motion, shares, skeleton)

    def shares(self, chunk: int, *, is_wanted: bool) -> Float[np.ndarray, " t"]:
        """How far it is turned in each frame of a chunk, smoothly between 0 and 1."""
        begin = self._ends.get(chunk - 1, 0.0)
        pace = 1 / (RISE_S * FRAME_RATE_HZ) if is_wanted else -1 / (FALL_S * FRAME_RATE_HZ)
        path = np.clip(begin + pace * np.arange(1, self._frames + 1), 0, 1)
        self._ends[chunk] = float(path[-1])
        for old in [known for known in self._ends if known < chunk - KEPT]:
            del self._ends[old]
        return np.asarray(path**3 * (10 - path * (15 - 6 * path)), np.float32)


def head_turned(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """Neck and head turned to the viewer; a rig without them stays."""
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


def eyes_turned(motion: MotionChunk, shares: Float[np.ndarray, " t"], skeleton: Skeleton) -> MotionChunk:
    """The eyes on the viewer, from wherever the head is turned to, as far as eyes go."""
    if not shares.any() or motion.face is None or not _has_neck(skeleton):
        return motion
    _, neck, head = _chain(motion, skeleton)
    world = lanes.multiply(neck, head)
    viewer = _rotated(lanes.conjugate(world), np.array([0, 0, 1], np.float32))  # as the head sees it
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
    """Radians between where the head faces and the viewer."""
    _, neck, head = _chain(motion, skeleton)
    turn = _to_viewer(lanes.multiply(neck, head))
    return np.asarray(np.sqrt(lanes.dot(turn, turn)))


def _has_neck(skeleton: Skeleton) -> bool:
    return {"neck", "head"} <= set(skeleton.names)


def _chain(motion: MotionChunk, skeleton: Skeleton) -> tuple[Quaternions, Quaternions, Quaternions]:
    """In the world: what bears the neck, and the neck; and the head relative to the neck."""
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
    """The shortest turn, in the world, of what faces along its own +Z to the world's +Z."""
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
