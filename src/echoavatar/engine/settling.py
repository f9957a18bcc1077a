"""When to stop dancing: what the paper leaves open, an abrupt end of the music.

The model hears its own last seconds of motion, and a dance goes on for want of anything else: up to three seconds, at
full speed. So when sound breaks off while the legs are in a dance, the model is made to forget (its context, not where
the body stands): it then goes on as a session begins that has stood through silence, which is to come to rest. Gestures
come to rest by themselves, and pauses in speech keep what was going on.

Decisions are made on chunks that were heard and motion that was made, so a session that is taken back decides again
the same.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton
from ..pipeline import MotionChunk
from ..pipeline.pipeline import SILENCE
from ..timing import CHUNK, FRAME_RATE_HZ, ChunkSize

DANCING = 15.0  # degrees per second, mean over the legs' joints: standing and talking mostly stay under 10
RECENT_S = 0.8  # before the silence, of which the liveliest chunk counts: dances stand still between moves
AGAIN_S = 0.8  # of silence after which one that dances on is made to forget once more
KEPT = 64  # chunks that are remembered
_LEGS = ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg")


class _Chunk(NamedTuple):
    silent: int  # chunks of silence so far, this one included
    legs: float  # degrees per second


class Settling:
    """One session's."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._recent, self._again = chunk.within(RECENT_S), chunk.within(AGAIN_S)
        self._chunks: dict[int, _Chunk] = {}

    def must_forget(self, chunk: int, audio: Float[np.ndarray, " s"]) -> bool:
        """Before a chunk is made: whether its sound breaks off a dance."""
        silent = self._silent(chunk, audio)
        recent = range(chunk - (self._recent if silent == 1 else 1), chunk)
        legs = max((self._chunks[past].legs for past in recent if past in self._chunks), default=0.0)
        return silent % self._again == 1 and legs > DANCING

    def made(
        self, chunk: int, audio: Float[np.ndarray, " s"], motion: MotionChunk, skeleton: Skeleton
    ) -> None:
        """A chunk was made."""
        self._chunks[chunk] = _Chunk(self._silent(chunk, audio), leg_speed(motion, skeleton))
        self._chunks.pop(chunk - KEPT, None)

    def _silent(self, chunk: int, audio: Float[np.ndarray, " s"]) -> int:
        if float(np.sqrt(np.mean(np.square(audio)))) > SILENCE:
            return 0
        before = self._chunks.get(chunk - 1)
        return 1 if before is None else before.silent + 1


def leg_speed(motion: MotionChunk, skeleton: Skeleton) -> float:
    """Mean turn of hip and knee joints, degrees per second."""
    legs = [skeleton.index(name) for name in _LEGS if name in skeleton.names]
    turns = motion.rotations[:, legs]
    if len(turns) < 2 or not legs:
        return 0.0
    half = np.minimum(
        np.linalg.norm(turns[1:] - turns[:-1], axis=-1), np.linalg.norm(turns[1:] + turns[:-1], axis=-1)
    )
    return float(np.degrees(2 * half).mean() * FRAME_RATE_HZ)
