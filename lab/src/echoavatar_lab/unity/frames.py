"""Convert motion to what the published Unity client expects: its axes, 60 fps, 47 face channels, and its messages.

The conversion follows the published server exactly, so that its client shows the same motion: the last frame of a block
is doubled instead of being interpolated across the border, and the face is smoothed block by block. Rotations are
conjugated by a matrix that mirrors, while positions are only rotated; the client undoes both. A message is a four-byte
big-endian length and JSON, one for each block of motion.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.arkit import APPLE_NAMES, reorder
from echoavatar.motion.arkit import ARKIT_NAMES as OURS
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.whole_file import whole_file

BLOCK_FRAMES = 12  # 0.4 s at 30 fps, the content of one message
BLEND_FRAMES = 3  # first frames of a block, blended with the last face of the previous block
_WINDOW, _DEGREE = 5, 2  # Savitzky-Golay filter
_EYES_BROWS_JAW = (0, 7, 5, 12, 1, 8, 2, 9, 6, 13, 3, 10, 4, 11, 41, 42, 43, 44, 45, 14, 15, 17, 16)
_MOUTH = (21, 22, 25, 26, 23, 24, 27, 28, 29, 30, 32, 31)
_MERGED: tuple[tuple[int, ...], ...] = (
    *((channel,) for channel in (*_EYES_BROWS_JAW, *_MOUTH)),
    (39, 40),
    (37, 38),
    *((channel,) for channel in (34, 19, 20, 33)),
    (35, 36),
    (49, 50),
    *((channel,) for channel in (46, 47, 48, 18)),
)
FACE_CHANNELS = len(_MERGED)  # 47


FACE47_NAMES = tuple(
    APPLE_NAMES[channels[0]] if len(channels) == 1 else APPLE_NAMES[channels[0]].removesuffix("Left")
    for channels in _MERGED
)


class Block(NamedTuple):
    """A block at 60 fps, as it is sent."""

    pose: Float[np.ndarray, "t j 4"]  # xyzw
    trans: Float[np.ndarray, "t 3"]  # centimetres
    blendshape: Float[np.ndarray, "t 47"]


class UnityAxes:
    """Converts rotations and positions of a rig to Unity's axes."""

    def __init__(self, rig: RigConfig) -> None:
        """Raises CheckpointError if the bundle has no transforms for Unity."""
        if not rig.unity:
            raise CheckpointError("this bundle has no transforms for Unity; import it from the authors' release")
        self._axes = np.array(rig.axes)
        self._matrices = np.array(rig.unity)
        self._inverse = np.linalg.inv(self._matrices)
        self._units = 1 / rig.metres_per_unit

    def rotations(self, quaternions: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "t j 4"]:
        """Our quaternions (`wxyz`) as quaternions in Unity's axes (`xyzw`)."""
        ours = matrix_from_quaternion(quaternions.astype(np.float64))
        turned = self._matrices @ (self._axes.T @ ours @ self._axes) @ self._inverse
        return quaternion_from_matrix(turned)[..., [1, 2, 3, 0]].astype(np.float32)

    def positions(self, root: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
        """Our positions in metres as positions in Unity's axes in centimetres."""
        x, y, z = (root.astype(np.float64) @ self._axes).T * self._units
        return np.stack([x, z, -y], 1).astype(np.float32)


def merge_channels(curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 47"]:
    """Reduce 52 channels in the release's order to its 47: some are dropped, and pairs become their maximum."""
    return np.stack([curves[:, list(pair)].max(1) for pair in _MERGED], 1)


def face47(curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 47"]:
    """The 47 channels of curves in our canonical order."""
    return merge_channels(reorder(curves, OURS, APPLE_NAMES))


def write_face47(path: Path, curves: Float[np.ndarray, "t 52"], fps: float) -> None:
    """Write the 47 channels as CSV, one row per frame, with the time in seconds first.

    Raises MotionError if the file cannot be written.
    """
    times = np.arange(len(curves))[:, None] / fps
    table = np.concatenate([times, face47(curves)], 1)
    with whole_file(path, error=MotionError) as partial:
        np.savetxt(partial, table, "%.6f", ",", header=",".join(("time", *FACE47_NAMES)), comments="")


def smoothed(block: Float[np.ndarray, "t c"], last: Float[np.ndarray, " c"] | None) -> Float[np.ndarray, "t c"]:
    """Smooth a block, and blend its first frames with the last frame of the previous smoothed block."""
    smooth = np.asarray(savgol_filter(block, _WINDOW, _DEGREE, axis=0))
    if last is None:
        return smooth
    shares = (np.arange(BLEND_FRAMES)[:, None] + 1) / (BLEND_FRAMES + 1)
    return np.concatenate([shares * smooth[:BLEND_FRAMES] + (1 - shares) * last, smooth[BLEND_FRAMES:]])


def at_60_fps(frames: Float[np.ndarray, "t ..."]) -> Float[np.ndarray, "u ..."]:
    """From 30 to 60 fps for vectors: insert midpoints, and repeat the last frame."""
    following = np.concatenate([frames[1:], frames[-1:]])
    return np.stack([frames, (frames + following) / 2], 1).reshape(-1, *frames.shape[1:])


def rotations_at_60_fps(frames: Float[np.ndarray, "t j 4"]) -> Float[np.ndarray, "u j 4"]:
    """From 30 to 60 fps for unit quaternions, whose midpoints are unit quaternions again."""
    following = np.concatenate([frames[1:], frames[-1:]])
    following = following * np.where((frames * following).sum(-1, keepdims=True) < 0, -1, 1)
    between = frames + following
    between = between / np.linalg.norm(between, axis=-1, keepdims=True)
    return np.stack([frames, between], 1).reshape(-1, *frames.shape[1:])


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
