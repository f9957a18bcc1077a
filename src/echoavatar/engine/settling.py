"""When a session's model must forget its motion, because it dances on in silence or stands still in music.

The model continues its own last seconds of motion, so whatever they hold goes on: a dance for seconds into silence, and
a rest for half a minute into music (the paper leaves both open). Then the model's context is cleared, and the body's
position is kept. The model goes on like a session that has stood through silence: it comes to rest in silence, and
dances to music within two seconds. Gestures come to rest by themselves, and pauses in speech change nothing.
In talk, a speaker whose hands rest is first told to be lively and to work, see `SpeakerManner.at`.

Decisions depend on the chunks heard and the motion made, so a session that goes back decides the same again.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.rotations import quaternion_multiply
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

SILENCE, SILENCE_S = 0.003, 0.26  # largest RMS of silence, -50 dBFS, and its least length: sound has shorter gaps
STANDING = 15.0  # degrees per second, mean over the legs' joints: a body that stands stays under 10
DANCES, DANCES_S = 40.0, 4.0  # mean speed over 4 s that only dances reach; steps while talking stay under 38
RECENT_S = 0.8  # of silence in which a dance still counts as one
AGAIN_S = 0.8  # of silence after which the context of a dance that goes on is cleared again
RESTING = 27.0  # degrees per second, mean over the arms' joints (`arm_speed`) behind `Stillness`: wrists at 0.3 m/s
STIRS_S = 0.53  # of sound after which arms at rest are asked to work
DANCE_RESTS_S, TALK_RESTS_S = 0.4, 2.13  # of sound after which arms at rest are freed, in a dance and else
KEPT_S = 17.0  # how long chunks are remembered
_LEGS = ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg")
_SHOULDERS = ("leftShoulder", "rightShoulder")
_ARMS = ("leftUpperArm", "rightUpperArm", "leftLowerArm", "rightLowerArm")


class _Chunk(NamedTuple):
    quiet: int  # chunks without sound so far, this one included
    silent: int  # those of them that count as silence
    legs: float  # degrees per second
    resting: int  # chunks of sound so far, across pauses, in which the arms rest, this one included
    dances: bool  # whether the legs danced since the last silence


class Settling:
    """Decides for one session when the model must forget its motion."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._recent, self._again, self._dances = (chunk.within(span) for span in (RECENT_S, AGAIN_S, DANCES_S))
        self._dance_rests, self._talk_rests = (chunk.within(span) for span in (DANCE_RESTS_S, TALK_RESTS_S))
        self._least, self._kept, self._stirs = (chunk.within(span) for span in (SILENCE_S, KEPT_S, STIRS_S))
        self._chunks: dict[int, _Chunk] = {}

    def must_forget(self, chunk: int, audio: Float[np.ndarray, " s"], *, acts: bool = False) -> bool:
        """Whether the next chunk, of sound `audio`, is silence in which a dance goes on, or sound in which arms rest.

        While an action runs (`acts`), arms rest because it asks for that.
        """
        silent, before = self.silence(chunk, audio), self._chunks.get(chunk - 1)
        if before is None:
            return False
        if not silent:
            most = self._dance_rests if before.dances else self._talk_rests
            return not acts and before.resting % most == 0 < before.resting
        if silent % self._again != 1 or not self.is_dancing(chunk - silent):
            return False
        return silent == 1 or before.legs > STANDING

    def rests(self, chunk: int) -> bool:
        """Whether the arms have rested in sound for `STIRS_S` before this chunk, the next one."""
        return chunk - 1 in self._chunks and self._chunks[chunk - 1].resting >= self._stirs

    def is_dancing(self, chunk: int) -> bool:
        """Whether the legs danced to sound in the last seconds up to this chunk, whose motion is made."""
        mean = self._legs(chunk, self._dances)
        return mean > DANCES and chunk in self._chunks and self._chunks[chunk].silent < self._recent

    def made(
        self, chunk: int, audio: Float[np.ndarray, " s"], motion: MotionChunk, skeleton: Skeleton, *, size: float = 1.0
    ) -> None:
        """Note a chunk that was made. `size` is the factor on its speaker's gestures, not on dances."""
        before = self._chunks.get(chunk - 1, _Chunk(0, 0, 0.0, 0, False))
        quiet, silent = self._quiet(chunk, audio), self.silence(chunk, audio)
        most = RESTING * (1 if before.dances else size)
        rests = _ARMS[0] in skeleton.names and arm_speed(motion, skeleton) < most
        rested = before.resting + (not silent) if rests and silent < self._recent else 0
        legs = joint_speed(motion, skeleton, _LEGS)
        now = self._chunks[chunk] = _Chunk(quiet, silent, legs, rested, before.dances)
        # Half the time finds dances that soon come to rest; steps of a talk that it mistakes only free the arms sooner.
        dances = silent < self._recent and (before.dances or self._legs(chunk, self._dances // 2 + 1) > DANCES)
        self._chunks[chunk] = now._replace(dances=dances)
        self._chunks.pop(chunk - self._kept, None)

    def _legs(self, chunk: int, count: int) -> float:
        """Mean speed of the legs in the last `count` chunks up to this one; chunks that were not made count as 0."""
        return sum(self._chunks[at].legs for at in range(chunk - count + 1, chunk + 1) if at in self._chunks) / count

    def silence(self, chunk: int, audio: Float[np.ndarray, " s"]) -> int:
        """Chunks of silence in a row up to and with the next one, of this sound; 0 while there is sound."""
        return max(0, self._quiet(chunk, audio) - self._least + 1)

    def _quiet(self, chunk: int, audio: Float[np.ndarray, " s"]) -> int:
        if np.dot(audio, audio) > SILENCE**2 * len(audio):
            return 0
        before = self._chunks.get(chunk - 1)
        return self._least if before is None else before.quiet + 1


def joint_speed(motion: MotionChunk, skeleton: Skeleton, names: Sequence[str]) -> float:
    """Mean rotation speed of these joints, degrees per second; 0 for a rig without them."""
    return _speed(motion.rotations[:, [skeleton.index(name) for name in names if name in skeleton.names]])


def arm_speed(motion: MotionChunk, skeleton: Skeleton) -> float:
    """Mean rotation speed of forearms, and of upper arms in the chest's frame, degrees per second.

    A shoulder that takes over a part of its arm's rotation (`motion.stages.carriage`) leaves it as it is.
    """
    if not {*_ARMS, *_SHOULDERS} <= set(skeleton.names):
        return joint_speed(motion, skeleton, _ARMS)
    arms, shoulders = (motion.rotations[:, skeleton.indices(names)] for names in (_ARMS, _SHOULDERS))
    return _speed(np.concatenate([quaternion_multiply(shoulders, arms[:, :2]), arms[:, 2:]], axis=1))


def _speed(rotations: Float[np.ndarray, "t j 4"]) -> float:
    if len(rotations) < 2 or not rotations.shape[1]:
        return 0.0
    now, then = rotations[1:], rotations[:-1]
    half = np.minimum(np.linalg.norm(now - then, axis=-1), np.linalg.norm(now + then, axis=-1))
    return float(np.degrees(2 * half).mean() * FRAME_RATE_HZ)
