"""The published wire format: a four-byte big-endian length and JSON, one message per block of motion."""

import json
import struct
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.timing import SAMPLES_PER_FRAME

from .frames import BLOCK_FRAMES, FACE_CHANNELS, Block, UnityAxes, at_60_fps, face47, rotations_at_60_fps, smoothed

HEADER = struct.Struct(">I")
LARGEST = 4 << 20  # bytes of the longest message accepted from a sender
BLOCK_SAMPLES = BLOCK_FRAMES * SAMPLES_PER_FRAME
_DIGITS = 6


class Messages:
    """Packs chunks of motion with their sound into messages; a remainder waits for the next chunk."""

    def __init__(self, rig: RigConfig) -> None:
        """Raises CheckpointError if the bundle has no transforms for Unity."""
        self._axes = UnityAxes(rig)
        self._last: np.ndarray | None = None  # last smoothed face
        self._motion: list[MotionChunk] = []
        self._audio = np.zeros(0, np.float32)

    def push(self, motion: MotionChunk, audio: Float[np.ndarray, " s"]) -> Iterator[bytes]:
        """The messages that this chunk completes."""
        self._motion.append(motion)
        self._audio = np.concatenate([self._audio, audio])
        while sum(len(chunk.root) for chunk in self._motion) >= BLOCK_FRAMES:
            whole = join(self._motion)
            block = self.block(whole.part(0, BLOCK_FRAMES))
            self._motion = [whole.part(BLOCK_FRAMES)]
            sound, self._audio = self._audio[:BLOCK_SAMPLES], self._audio[BLOCK_SAMPLES:]
            yield framed(encoded(block, sound))

    def block(self, motion: MotionChunk) -> Block:
        """Convert twelve frames to a block."""
        rotations, positions = self._axes.rotations(motion.rotations), self._axes.positions(motion.root)
        face = np.zeros((len(positions), FACE_CHANNELS)) if motion.face is None else face47(motion.face)
        smooth = smoothed(face, self._last)
        self._last = smooth[-1]
        return Block(rotations_at_60_fps(rotations), at_60_fps(positions), at_60_fps(smooth))


def encoded(block: Block, audio: Float[np.ndarray, " s"]) -> bytes:
    """The JSON of a message."""
    parts = {"pose": block.pose, "trans": block.trans, "blendshape": block.blendshape, "audio": audio}
    lists = {name: np.round(part.astype(np.float64), _DIGITS).tolist() for name, part in parts.items()}
    return json.dumps(lists, separators=(",", ":")).encode()


def framed(payload: bytes) -> bytes:
    """The payload, preceded by its length."""
    return HEADER.pack(len(payload)) + payload
