"""Eye contact: the eyes meet the viewer for a share of the time and glance away between. Not in the paper.

The viewer stands on the avatar's +Z side and moves along with it, as the page's camera does. While the user speaks,
neck and head make most of the rotation, within the range of a neck, and keep a little of their own movement; else they
help where the eyes alone do not reach. The eyes make the rest, through the look curves of the face.

People look at the other for 41 % of the time in which they speak and for 75 % of that in which they listen (reported
after Argyle). Of long utterances, over 70 % begin with a look away, and as many end with a look at the listener
(Kendon 1967).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.timing import CHUNK, FRAME_RATE_HZ, SAMPLES_PER_FRAME, ChunkSize

from .action_overlay import Overlay, apply_overlay
from .arkit import ARKIT_NAMES
from .kinematics import Skeleton
from .kinematics.easing import smootherstep
from .kinematics.rotations import length, matrix_from_axis_angle, matrix_from_quaternion, quaternion_from_matrix
from .motion_chunk import KEPT, ChunkFade, MotionChunk

CONTACT = 0.5  # the share of the time in which a speaker's eyes meet the viewer, unless a session asks for another
LISTENS = 1.5  # times that share in silence and while the user speaks
RISE_S, FALL_S = 0.5, 0.8  # to eye contact, and out of it
HEAD_SHARE, NECK_SHARE = 0.8, 0.35  # of the rotation: head and neck together; of that, the neck alone
FARTHEST = math.radians(55)  # the largest rotation of head and neck together
EYES_ALONE = math.radians(10)  # off the viewer up to which a speaker's head does not help
HELPS = 0.65  # of what is beyond: the head's own movement stays to be seen
# Beyond the first angle the avatar looks at the viewer less; beyond the second, not at all.
WELCOME, BEHIND = math.radians(80), math.radians(140)
LOOK = math.radians(30)  # how far an eye of our character rotates at a look curve of 1; 34 degrees in Live Link Face
GLANCES = 0.3  # the share of the eyes' own small movements that stays

AT_STARTS = 0.75  # of the phrases begin with a glance away, at the usual share of contact
PAUSE_S = 0.25  # of silence, after which a phrase begins
ENDS_S = 0.2  # of silence, in which a glance ends: phrases end with a look at the viewer
SPEAKS_S = 0.6  # of silence, in which a speaker still counts as one
AWAY_S = (0.6, 1.5)  # a speaker's glance
QUIET_AWAY_S = (0.4, 0.9)  # a listener's
OWED_S = (0.3, 0.9)  # contact over its share after which the eyes glance away within a phrase
MOST_OWED_S = 1.5  # under or over it, so that one long pause does not decide the next minute
ASIDE, UPWARDS = np.radians([9, 18]), np.radians([-10, 7])  # where glances go from the viewer
SACCADE = 2  # frames
QUIET_DB = 25.0  # under the loudest of the last seconds, sound is a pause
FAINTEST_DB = -60.0  # so is fainter sound
_FORGETS_DB = 0.15  # per frame: the loudest of the last seconds fades

_CHAIN = ("hips", "spine", "chest", "upperChest", "neck", "head")
_EYES = [[ARKIT_NAMES.index(f"eyeLook{way}{side}") for side in ("Left", "Right")] for way in ("Up", "Down")]
_LEFTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookOutLeft", "eyeLookInRight")]
_RIGHTWARDS = [ARKIT_NAMES.index(name) for name in ("eyeLookInLeft", "eyeLookOutRight")]


class _Place(NamedTuple):
    """Where the eyes are in the course of looks and glances, after a frame. Times are in frames."""

    away: int = 0  # left of the glance; 0: the eyes meet the viewer
    since: int = SACCADE  # the last saccade
    old: tuple[float, float] = (0.0, 0.0)  # yaw and pitch off the viewer before it, radians
    new: tuple[float, float] = (0.0, 0.0)  # and after it
    owed: float = 0.0  # contact over its share
    most: float = OWED_S[0] * FRAME_RATE_HZ  # of it, before the eyes glance away
    silent: int = round(9 * FRAME_RATE_HZ)  # since the speaker was heard last
    loudest: float = FAINTEST_DB  # of the last seconds


class Gaze:
    """The eye contact of one session."""

    def __init__(self, seed: int = 0, contact: float = CONTACT, chunk: ChunkSize = CHUNK) -> None:
        """`contact` is the share of the time in which the eyes meet the viewer while the avatar speaks, 0 to 1."""
        self._seed, self._contact = seed, contact
        self._heed, self._fade = (ChunkFade(RISE_S, FALL_S, chunk=chunk) for _ in range(2))
        self._places: dict[int, _Place] = {}

    def apply(
        self,
        chunk: int,
        motion: MotionChunk,
        skeleton: Skeleton,
        *,
        overlay: Overlay | None = None,
        heeds: bool,
        speech: Float[np.ndarray, " s"] | None = None,
    ) -> MotionChunk:
        """Add eye contact, and an action's overlay on top. A nod then lowers the head, not the eyes.

        Args:
            chunk: its number.
            motion: what the chunk shows so far.
            skeleton: its rig.
            overlay: the action's.
            heeds: whether head and eyes turn to the user, who speaks.
            speech: what the avatar says in the chunk, 24 kHz: eyes meet the viewer for their share; None: they do not.
        """
        heed = self.shares(chunk, is_wanted=heeds)
        looks = smootherstep(self._fade.shares(chunk, is_wanted=speech is not None)).astype(np.float32)
        glances = self.glances(chunk, np.zeros(0, np.float32) if speech is None else speech, len(motion.root))
        motion = turn_head(motion, heed, looks, skeleton)
        motion = motion if overlay is None else apply_overlay(motion, overlay, skeleton)
        return turn_eyes(motion, np.maximum(heed, looks), glances * looks[:, None], skeleton)

    def shares(self, chunk: int, *, is_wanted: bool) -> Float[np.ndarray, " t"]:
        """How far the head has turned to a user who speaks, in each frame of a chunk, smoothed, 0 to 1."""
        return smootherstep(self._heed.shares(chunk, is_wanted=is_wanted)).astype(np.float32)

    def glances(self, chunk: int, speech: Float[np.ndarray, " s"], frames: int) -> Float[np.ndarray, "t 2"]:
        """How far the eyes look beside the viewer in each frame, to the avatar's left and up, radians."""
        sound = np.pad(speech, (0, max(0, frames * SAMPLES_PER_FRAME - len(speech))))[: frames * SAMPLES_PER_FRAME]
        power = np.mean(np.square(sound.reshape(frames, -1), dtype=np.float64), axis=1)
        place, path = self._places.get(chunk - 1, _Place()), []
        for frame, level in enumerate(10 * np.log10(power + 1e-12), chunk * frames):
            place = self._next(frame, float(level), place)
            path.append(np.array(place.old) + (np.array(place.new) - place.old) * min(1, place.since / SACCADE))
        self._places[chunk] = place
        self._places.pop(chunk - KEPT, None)
        return np.array(path, np.float32)

    def _next(self, frame: int, level: float, place: _Place) -> _Place:
        """The next frame of looks and glances, whose sound has this level (dB)."""
        loudest = max(place.loudest - _FORGETS_DB, FAINTEST_DB + QUIET_DB, level)
        silent = 0 if level > loudest - QUIET_DB else place.silent + 1
        begins = silent == 0 and place.silent >= PAUSE_S * FRAME_RATE_HZ
        speaks = silent < SPEAKS_S * FRAME_RATE_HZ
        share = self._contact if speaks else min(1.0, LISTENS * self._contact)
        most = MOST_OWED_S * FRAME_RATE_HZ
        owed = min(max(place.owed + (-share if place.away else 1 - share), -most), most)
        place = place._replace(since=place.since + 1, owed=owed, silent=silent, loudest=loudest)
        if place.away:
            is_over = place.away == 1 or silent == round(ENDS_S * FRAME_RATE_HZ)
            if is_over and owed < place.most:
                return place._replace(away=0, since=1, old=place.new, new=(0.0, 0.0))
            return place._replace(away=max(1, place.away - 1))
        if not begins and owed < place.most:
            return place
        start, length, side, aside, upwards, later = np.random.default_rng([self._seed, 3, frame]).random(6)
        if owed < place.most and (start > AT_STARTS * min(1.0, 2 - 2 * self._contact) or owed <= -most):
            return place
        away, yaw = between(AWAY_S if speaks else QUIET_AWAY_S, length), between(ASIDE, aside)
        return place._replace(
            away=round(away * FRAME_RATE_HZ),
            since=1,
            old=place.new,
            new=(yaw if side < 0.5 else -yaw, between(UPWARDS, upwards)),
            most=between(OWED_S, later) * FRAME_RATE_HZ,
        )


def between(ends: Sequence[float] | Float[np.ndarray, " 2"], share: float) -> float:
    """The number so far from one end to the other."""
    return float(ends[0] + share * (ends[1] - ends[0]))


def turn_head(
    motion: MotionChunk, shares: Float[np.ndarray, " t"], helps: Float[np.ndarray, " t"], skeleton: Skeleton
) -> MotionChunk:
    """Turn neck and head to the viewer; a rig without them is left as it is.

    Where `helps` asks for more, they turn by that share of `HELPS` of what the eyes leave them.
    """
    if not (shares.any() or helps.any()) or not _has_neck(skeleton):
        return motion
    below, neck, head = _chain(motion, skeleton)
    rotation = _to_viewer(head)
    angle = np.maximum(length(rotation)[:, 0], 1e-6)
    largest = FARTHEST * np.clip((BEHIND - angle) / (BEHIND - WELCOME), 0, 1) / angle
    beyond = helps * np.minimum(HELPS * np.maximum(1 - EYES_ALONE / angle, 0), largest)
    rotation = rotation * np.maximum(shares * np.minimum(largest, HEAD_SHARE), beyond)[:, None]
    both = np.stack([NECK_SHARE * rotation, rotation], 1)
    new = matrix_from_axis_angle(both) @ np.stack([neck, head], 1)
    parents = np.stack([below, new[:, 0]], 1)
    rotations = motion.rotations.copy()
    rotations[:, skeleton.indices(["neck", "head"])] = quaternion_from_matrix(parents.mT @ new)
    return motion._replace(rotations=rotations)


def turn_eyes(
    motion: MotionChunk, shares: Float[np.ndarray, " t"], glances: Float[np.ndarray, "t 2"], skeleton: Skeleton
) -> MotionChunk:
    """Turn the eyes to the viewer, or beside (`glances`), from where the head faces, within the range of eyes."""
    if not shares.any() or motion.face is None or not _has_neck(skeleton):
        return motion
    viewer = _chain(motion, skeleton)[2][:, 2].T  # the direction of the world's +Z in the head's axes
    is_ahead = np.clip((BEHIND - np.arccos(np.clip(viewer[2], -1, 1))) / (BEHIND - WELCOME), 0, 1)
    left, up = glances.T
    yaw = np.clip((np.arctan2(viewer[0], np.maximum(viewer[2], 1e-6)) + left) / LOOK, -1, 1) * is_ahead
    pitch = np.clip((np.arcsin(np.clip(viewer[1], -1, 1)) + up) / LOOK, -1, 1) * is_ahead
    face, own = motion.face.copy(), (1 - (1 - GLANCES) * shares)[:, None]
    for columns, value in ((_LEFTWARDS, yaw), (_RIGHTWARDS, -yaw), (_EYES[0], pitch), (_EYES[1], -pitch)):
        face[:, columns] = np.clip(face[:, columns] * own + (shares * np.maximum(value, 0))[:, None], 0, 1)
    return motion._replace(face=face)


def _has_neck(skeleton: Skeleton) -> bool:
    return {"neck", "head"} <= set(skeleton.names)


def _chain(
    motion: MotionChunk, skeleton: Skeleton
) -> tuple[Float[np.ndarray, "t 3 3"], Float[np.ndarray, "t 3 3"], Float[np.ndarray, "t 3 3"]]:
    """World rotations of the neck's parent, the neck and the head; only the spine is multiplied out."""
    joints = skeleton.indices([name for name in _CHAIN if name in skeleton.names])
    world = [np.tile(np.eye(3, dtype=np.float32), (len(motion.rotations), 1, 1))]
    for local in matrix_from_quaternion(motion.rotations[:, joints].astype(np.float32)).swapaxes(0, 1):
        world.append(world[-1] @ local)
    return world[-3], world[-2], world[-1]


def _to_viewer(world: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t 3"]:
    """The rotation vector, in world axes, that takes each frame's own +Z to the world's +Z."""
    x, y, z = world[:, :, 2].T
    axis, sine = np.stack([y, -x, 0 * x], -1), np.hypot(x, y)  # (x, y, z) x (0, 0, 1)
    vector: np.ndarray = axis * (np.arctan2(sine, z) / np.maximum(sine, 1e-6))[:, None]
    return vector
