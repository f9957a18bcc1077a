"""When to stop dancing: an abrupt end of the music, which the paper leaves open.

The model continues its own last seconds of motion, so a dance goes on for seconds into silence. When sound breaks off
while the legs dance, the model's context is cleared; the body's position is kept. The model then goes on like a session
that has stood through silence, and comes to rest. Gestures come to rest by themselves, and pauses in speech change
nothing.

Decisions depend on the chunks heard and the motion made, so a session that goes back decides the same again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

SILENCE = 0.003  # RMS of a silent chunk, -50 dBFS
STANDING = 15.0  # degrees per second, mean over the legs' joints: a body that stands stays under 10
DANCES, DANCES_S = 40.0, 4.0  # a mean speed over that time that only dances reach; steps while talking are under 38
RECENT_S = 0.8  # of silence in which a dance still counts as one
AGAIN_S = 0.8  # of silence after which the context of a dance that goes on is cleared again
KEPT = 64  # chunks that are remembered
_LEGS = ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg")


class _Chunk(NamedTuple):
    silent: int  # chunks of silence so far, this one included
    legs: float  # degrees per second


class Settling:
    """Decides for one session when the model must forget its motion."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._recent, self._again, self._dances = (chunk.within(span) for span in (RECENT_S, AGAIN_S, DANCES_S))
        self._chunks: dict[int, _Chunk] = {}

    def must_forget(self, chunk: int, audio: Float[np.ndarray, " s"]) -> bool:
        """Whether the chunk that comes next is silence that breaks off a dance, or in which the dance still goes on."""
        silent = self._silent(chunk, audio)
        if silent % self._again != 1 or not self.is_dancing(chunk - silent):
            return False
        return silent == 1 or self._chunks[chunk - 1].legs > STANDING

    def is_dancing(self, chunk: int) -> bool:
        """Whether the legs danced to sound in the last seconds up to this chunk, which was made."""
        past = [self._chunks[at] for at in range(chunk - self._dances + 1, chunk + 1) if at in self._chunks]
        mean = sum(each.legs for each in past) / self._dances
        return mean > DANCES and past[-1].silent < self._recent

    def made(self, chunk: int, audio: Float[np.ndarray, " s"], motion: MotionChunk, skeleton: Skeleton) -> None:
        """Note a chunk that was made."""
        self._chunks[chunk] = _Chunk(self._silent(chunk, audio), leg_speed(motion, skeleton))
        self._chunks.pop(chunk - KEPT, None)

    def _silent(self, chunk: int, audio: Float[np.ndarray, " s"]) -> int:
        if float(np.sqrt(np.mean(np.square(audio)))) > SILENCE:
            return 0
        before = self._chunks.get(chunk - 1)
        return 1 if before is None else before.silent + 1


def leg_speed(motion: MotionChunk, skeleton: Skeleton) -> float:
    """Mean rotation speed of hip and knee joints, degrees per second."""
    legs = [skeleton.index(name) for name in _LEGS if name in skeleton.names]
    rotations = motion.rotations[:, legs]
    if len(rotations) < 2 or not legs:
        return 0.0
    now, then = rotations[1:], rotations[:-1]
    half = np.minimum(np.linalg.norm(now - then, axis=-1), np.linalg.norm(now + then, axis=-1))
    return float(np.degrees(2 * half).mean() * FRAME_RATE_HZ)
