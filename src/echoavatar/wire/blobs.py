"""Poses and sound as little-endian bytes: int16 quaternions, float32 root, uint8 face, int16 samples.

A chunk of 4 frames, 52 joints and 52 face curves is 1,920 bytes; the largest rotation error is under 0.005 degrees.
On the wire quaternions are x y z w, as in glTF, three.js, Unity and Unreal; in Python they are wxyz.
"""

from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float

from .codec import ProtocolError
from .messages import Audio, AudioFormat, AvatarState, Motion

_QUATERNION_SCALE = 32_767
_FACE_SCALE = 255


class Pose(NamedTuple):
    """Frames of one session at 30 fps."""

    rotations: Float[np.ndarray, "t j 4"]  # quaternions wxyz, parent-relative
    root: Float[np.ndarray, "t 3"]  # metres
    face: Float[np.ndarray, "t c"] | None  # ARKit curves 0..1


def pack_pose(pose: Pose, *, at: int, epoch: int = 0, state: AvatarState = "idle") -> Motion:
    """Pack a motion message. Every quaternion gets w >= 0, so that equal poses have equal bytes."""
    xyzw = np.roll(pose.rotations, -1, axis=-1)
    xyzw = np.where(xyzw[..., 3:] < 0, -xyzw, xyzw)
    face = b""
    if pose.face is not None:
        face = np.rint(np.clip(pose.face, 0, 1) * _FACE_SCALE).astype("u1").tobytes()
    return Motion(
        at=at,
        epoch=epoch,
        frames=len(pose.root),
        rotations=np.rint(np.clip(xyzw, -1, 1) * _QUATERNION_SCALE).astype("<i2").tobytes(),
        root=pose.root.astype("<f4").tobytes(),
        face=face,
        state=state,
    )


def unpack_pose(motion: Motion, *, joints: int = 52, curves: int = 52) -> Pose:
    """Unpack the frames of a motion message; quaternions are normalised.

    Raises ProtocolError if the bytes do not fit the number of frames, or a root position is not finite.
    """
    frames = motion.frames
    sizes = (len(motion.rotations), len(motion.root), len(motion.face))
    if frames < 1 or sizes[:2] != (frames * joints * 8, frames * 12) or sizes[2] not in (0, frames * curves):
        raise ProtocolError("bad_message", f"motion of {frames} frames with {sizes} bytes of rotations, root and face")
    xyzw = np.frombuffer(motion.rotations, "<i2").reshape(frames, joints, 4).astype(np.float32)
    xyzw /= np.maximum(np.linalg.norm(xyzw, axis=-1, keepdims=True), 1)
    root = np.frombuffer(motion.root, "<f4").reshape(frames, 3).astype(np.float32)
    if not np.isfinite(root).all():
        raise ProtocolError("bad_message", "motion whose root holds values that are not finite")
    face = None
    if motion.face:
        face = np.frombuffer(motion.face, "u1").reshape(frames, curves).astype(np.float32) / _FACE_SCALE
    return Pose(np.roll(xyzw, 1, axis=-1), root, face)


def pack_audio(samples: Float[np.ndarray, " s"]) -> bytes:
    """Pack mono samples in [-1, 1] as s16le; louder samples are clipped."""
    return bytes(np.rint(np.clip(samples, -1, 1) * 32_767).astype("<i2").data)


def unpack_audio(pcm: bytes, form: AudioFormat) -> Float[np.ndarray, " s"]:
    """Unpack an audio message to mono floats at the format's own rate.

    Raises ProtocolError if the bytes are not a whole number of samples, or values are not finite.
    """
    if len(pcm) % form.width:
        raise ProtocolError(
            "bad_audio", f"{len(pcm)} bytes are not a whole number of {form.format} x {form.channels}", fatal=False
        )
    if form.format == "s16le":
        samples = np.frombuffer(pcm, "<i2").astype(np.float32) / 32_768
    else:
        samples = np.frombuffer(pcm, "<f4").astype(np.float32)
        if not np.isfinite(samples).all():
            raise ProtocolError("bad_audio", "audio holds values that are not finite", fatal=False)
        samples = np.clip(samples, -8, 8)
    mono: Float[np.ndarray, " s"] = samples.reshape(-1, form.channels).mean(axis=1, dtype=np.float32)
    return mono


def split_audio(message: Audio, form: AudioFormat) -> Iterator[Audio]:
    """Parts of an audio message, each at most a second long, in order."""
    step = form.rate * form.width
    for at in range(0, len(message.pcm) or 1, step):
        start = message.start + at // form.width
        yield msgspec.structs.replace(message, start=start, pcm=message.pcm[at : at + step])
