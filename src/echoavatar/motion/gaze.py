"""Eye contact: the eyes meet the viewer for a share of the time and glance away between. Not in the paper.

The viewer stands on the avatar's +Z side and moves along with it, as the page's camera does. While the user speaks,
neck and head make most of the rotation, within the range of a neck, and keep a little of their own movement; at other
times they help where the eyes alone do not reach. The eyes make the rest, through the look curves of the face.

People look at the other for 41 % of the time in which they speak and for 75 % of that in which they listen (reported
after Argyle). Of long utterances, over 70 % begin with a look away, and as many end with a look at the listener
(Kendon 1967).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from echoavatar.nn.kernels import kernel
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, SAMPLES_PER_FRAME, ChunkSize

from .action_overlay import Overlay, apply_overlay
from .arkit import ARKIT_NAMES
from .feeling import FAINTEST_DB, QUIET_DB, loudest
from .kinematics import Skeleton
from .kinematics.easing import smootherstep
from .kinematics.quaternions import (
    IDENTITY,
    conjugate,
    from_rotation_vector,
    multiply,
    normalized,
    read_quaternion,
    rotate,
    rotate_back,
    times,
    write_quaternion,
)
from .motion_chunk import KEPT, ChunkFade, MotionChunk

CONTACT = 0.5  # the share of the time in which a speaker's eyes meet the viewer, unless a session asks for another
LISTENS = 1.5  # factor of that share in silence and while the user speaks
RISE_S, FALL_S = 0.5, 0.8  # to eye contact, and out of it
HEAD_SHARE, NECK_SHARE = 0.8, 0.35  # of the rotation to the viewer: head and neck; of theirs, the neck alone
FARTHEST = math.radians(55)  # the largest rotation of head and neck together
EYES_ALONE = math.radians(20)  # off the viewer up to which a speaker's head does not help
HELPS = 0.8  # share of the angle beyond that the head takes over: its own movement stays visible
# Beyond the first angle the avatar looks at the viewer less; beyond the second, not at all.
WELCOME, BEHIND = math.radians(80), math.radians(140)
LOOK = math.radians(30)  # how far an eye of our character rotates at a look curve of 1; 34 degrees in Live Link Face
GLANCES = 0.3  # the share of the eyes' own small movements that stays

AT_STARTS = 0.75  # share of phrases that begin with a glance away, at the default contact
PAUSE_S = 0.25  # of silence, after which a phrase begins
ENDS_S = 0.2  # of silence, after which a glance ends: phrases end with a look at the viewer
SPEAKS_S = 0.6  # of silence, within which a speaker still counts as speaking
AWAY_S = (0.6, 1.5)  # a speaker's glance
QUIET_AWAY_S = (0.4, 0.9)  # a listener's
OWED_S = (0.3, 0.9)  # seconds of contact beyond its share, after which the eyes glance away within a phrase
MOST_OWED_S = 1.5  # bound on seconds beyond or below the share, so that one long pause does not decide the next minute
ASIDE, UPWARDS = np.radians([9, 18]), np.radians([-10, 7])  # where glances go from the viewer
SACCADE = 2  # frames
_FORGETS_DB = 0.15  # per frame: the loudest of the last seconds fades

_CHAIN = ("hips", "spine", "chest", "upperChest", "neck", "head")
_LOOKS = np.array(  # columns of both eyes: to the left, to the right, up, down
    [
        [ARKIT_NAMES.index(name) for name in names]
        for names in (
            ("eyeLookOutLeft", "eyeLookInRight"),
            ("eyeLookInLeft", "eyeLookOutRight"),
            ("eyeLookUpLeft", "eyeLookUpRight"),
            ("eyeLookDownLeft", "eyeLookDownRight"),
        )
    ]
)


class _Place(NamedTuple):
    """The state of looks and glances after a frame. Times are in frames."""

    away: int = 0  # time left of the glance; 0: the eyes meet the viewer
    since: int = SACCADE  # the last saccade
    old: tuple[float, float] = (0.0, 0.0)  # yaw and pitch off the viewer before it, radians
    new: tuple[float, float] = (0.0, 0.0)  # and after it
    owed: float = 0.0  # contact beyond its share
    most: float = OWED_S[0] * FRAME_RATE_HZ  # value of `owed` at which the eyes glance away
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
            heeds: whether head and eyes turn to the user, because the user speaks.
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
        """How far the eyes look past the viewer in each frame, to the avatar's left and up, radians."""
        sound = np.zeros((frames, SAMPLES_PER_FRAME))
        sound.ravel()[: len(speech)] = speech[: sound.size]
        levels = 10 * np.log10(np.square(sound).mean(1) + 1e-12)
        place, path = self._places.get(chunk - 1, _Place()), []
        for frame, level in enumerate(levels.tolist(), chunk * frames):
            place = self._next(frame, level, place)
            there = min(1, place.since / SACCADE)
            path.append([old + (new - old) * there for old, new in zip(place.old, place.new, strict=True)])
        self._places[chunk] = place
        self._places.pop(chunk - KEPT, None)
        return np.array(path, np.float32)

    def _next(self, frame: int, level: float, place: _Place) -> _Place:
        """The next frame of looks and glances, whose sound has this level (dB)."""
        peak = loudest(place.loudest, level, _FORGETS_DB)
        silent = 0 if level > peak - QUIET_DB else place.silent + 1
        begins = silent == 0 and place.silent >= PAUSE_S * FRAME_RATE_HZ
        speaks = silent < SPEAKS_S * FRAME_RATE_HZ
        share = self._contact if speaks else min(1.0, LISTENS * self._contact)
        most = MOST_OWED_S * FRAME_RATE_HZ
        owed = min(max(place.owed + (-share if place.away else 1 - share), -most), most)
        place = place._replace(since=place.since + 1, owed=owed, silent=silent, loudest=peak)
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
    """Linear interpolation between two ends."""
    return float(ends[0] + share * (ends[1] - ends[0]))


def turn_head(
    motion: MotionChunk, shares: Float[np.ndarray, " t"], helps: Float[np.ndarray, " t"], skeleton: Skeleton
) -> MotionChunk:
    """Turn neck and head to the viewer; a rig without them is left as it is.

    `shares` is how far they turn to a speaking user, `helps` how far they help the eyes; the larger turn counts.
    """
    if not (shares.any() or helps.any()) or not _has_neck(skeleton):
        return motion
    rotations = motion.rotations.astype(np.float32)
    _turn_head(rotations, _chain(skeleton), shares.astype(np.float32), helps.astype(np.float32))
    return motion._replace(rotations=rotations)


def turn_eyes(
    motion: MotionChunk, shares: Float[np.ndarray, " t"], glances: Float[np.ndarray, "t 2"], skeleton: Skeleton
) -> MotionChunk:
    """Turn the eyes to the viewer, plus `glances` (radians), within the range of eyes."""
    if not shares.any() or motion.face is None or not _has_neck(skeleton):
        return motion
    face = motion.face.astype(np.float32)
    rotations, shares = motion.rotations.astype(np.float32), shares.astype(np.float32)
    _turn_eyes(face, rotations, _chain(skeleton), shares, glances.astype(np.float32))
    return motion._replace(face=face)


def warm_up(skeleton: Skeleton) -> None:
    """Compile the loops; the result is cached on disk."""
    still, shares = np.zeros((1, skeleton.joints, 4), np.float32), np.ones(1, np.float32)
    motion = MotionChunk(still, np.zeros((1, 3), np.float32), np.zeros((1, len(ARKIT_NAMES)), np.float32))
    turn_eyes(turn_head(motion, shares, shares, skeleton), shares, np.zeros((1, 2), np.float32), skeleton)


def _has_neck(skeleton: Skeleton) -> bool:
    return {"neck", "head"} <= set(skeleton.names)


def _chain(skeleton: Skeleton) -> Int[np.ndarray, " n"]:
    """The joints from the root to the head."""
    return np.array(skeleton.indices([name for name in _CHAIN if name in skeleton.names]))


@kernel()
def _world(local, chain, count):  # type: ignore[no-untyped-def]
    """World rotation of joint `count` - 1 of a chain, from a frame's local rotations (j, 4)."""
    world = IDENTITY
    for joint in chain[:count]:
        world = multiply(world, normalized(read_quaternion(local[joint])))
    return world


@kernel()
def _welcome(angle):  # type: ignore[no-untyped-def]
    """How far the avatar looks at a viewer at this angle (radians) from its front, 0 to 1."""
    return min(max((BEHIND - angle) / (BEHIND - WELCOME), 0.0), 1.0)


@kernel()
def _write(out, rotation):  # type: ignore[no-untyped-def]
    """Write a rotation as a unit quaternion with w >= 0."""
    w, x, y, z = normalized(rotation)
    write_quaternion(out, (w, x, y, z) if w >= 0.0 else (-w, -x, -y, -z))


@kernel()
def _turn_head(rotations, chain, shares, helps):  # type: ignore[no-untyped-def]
    """`turn_head` in place, for rotations (t, j, 4)."""
    for frame in range(len(rotations)):
        local = rotations[frame]
        below, neck = _world(local, chain, len(chain) - 2), _world(local, chain, len(chain) - 1)
        head = _world(local, chain, len(chain))
        x, y, z = rotate(head, (0.0, 0.0, 1.0))
        sine = math.hypot(x, y)
        angle = max(math.atan2(sine, z) if sine > 0 else 0.0, 1e-6)
        largest = FARTHEST * _welcome(angle) / angle
        beyond = helps[frame] * min(HELPS * max(1.0 - EYES_ALONE / angle, 0.0), largest)
        share = max(shares[frame] * min(largest, HEAD_SHARE), beyond) * angle / max(sine, 1e-6)
        whole = (y * share, -x * share, 0.0)  # about (x, y, z) x (0, 0, 1): from the head's +Z to the world's
        neck = multiply(from_rotation_vector(times(whole, NECK_SHARE)), neck)
        head = multiply(from_rotation_vector(whole), head)
        _write(local[chain[-2]], multiply(conjugate(below), neck))
        _write(local[chain[-1]], multiply(conjugate(neck), head))


@kernel()
def _turn_eyes(face, rotations, chain, shares, glances):  # type: ignore[no-untyped-def]
    """`turn_eyes` in place, for curves (t, 52)."""
    for frame in range(len(face)):
        if shares[frame] == 0.0:
            continue
        x, y, z = rotate_back(_world(rotations[frame], chain, len(chain)), (0.0, 0.0, 1.0))  # the viewer
        is_ahead = _welcome(math.acos(min(max(z, -1.0), 1.0)))
        yaw = (math.atan2(x, max(z, 1e-6)) + glances[frame, 0]) / LOOK
        pitch = (math.asin(min(max(y, -1.0), 1.0)) + glances[frame, 1]) / LOOK
        for side in range(2):
            for way in range(4):
                wanted = (yaw, -yaw, pitch, -pitch)[way]
                wanted = min(max(wanted, -1.0), 1.0) * is_ahead
                column = _LOOKS[way, side]
                curve = face[frame, column] * (1.0 - (1.0 - GLANCES) * shares[frame]) + shares[frame] * max(wanted, 0.0)
                face[frame, column] = min(max(curve, 0.0), 1.0)
