"""Join new motion to the pose on screen without a pop (inertialisation).

When a stream is cut (`clear()`, a mode switched, a clip started), the new motion is shown at once, plus an offset: the
difference between the old and the new pose, and between their speeds. A quintic takes the offset to zero, with its
speed and acceleration, in 150 to 250 ms (Bollo's inertialisation in vector form). Unlike a cross-fade, this needs only
one motion at a time, and the new motion is not delayed. Not in the paper.

    blend = InertialBlend()
    blend.begin(shown)             # the last frames on screen, two or more (MotionChunk or any slice of one)
    chunk = blend.step(chunk)      # every chunk from then on; the first one needs two frames
"""

import math

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ

from .kinematics.easing import smootherstep
from .kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_multiply,
    standardize,
    unit,
)
from .motion_chunk import MotionChunk

Array = np.ndarray
SHORTEST_S, LONGEST_S = 0.150, 0.250
FASTEST = math.radians(800)  # per second: a joint whose offset would rotate faster takes longer than LONGEST_S
GREATEST_START = math.radians(600)  # per second: the speed difference with which an offset may start
ROOT_FASTEST = 2.0  # metres per second
FACE_SECONDS = 0.120
_STEEPEST = 1.875  # greatest slope of the decay, with time in units of its duration


class InertialBlend:
    """One session's offset. Chunks pass unchanged before `begin` and after the offset has ended."""

    def __init__(self) -> None:
        self._shown: MotionChunk | None = None
        self._offset: _Offset | None = None

    def begin(self, shown: MotionChunk) -> None:
        """Announce a cut. `shown` ends with the frame on screen; its last two frames give pose and speed.

        May be called again before an offset has ended: pass what was shown, offset included. Raises MotionError: fewer
        than two frames.
        """
        if len(shown.root) < 2:
            raise MotionError("a blend needs the last two frames on screen to know their speed; pass at least 2")
        self._shown, self._offset = shown.part(-2), None

    def step(self, chunk: MotionChunk) -> MotionChunk:
        """The next frames plus the offset. The first frame after `begin` follows the last one shown by one frame.

        Raises MotionError if the first chunk after `begin` has fewer than two frames.
        """
        if self._shown is not None:
            if len(chunk.root) < 2:
                raise MotionError("the first chunk after a cut needs two frames, to know its speed")
            self._offset, self._shown = _Offset(self._shown, chunk), None
        if self._offset is None:
            return chunk
        blended = self._offset.apply(chunk)
        if self._offset.is_over:
            self._offset = None
        return blended


class _Offset:
    """The difference between old and new motion one frame before the first new frame."""

    def __init__(self, old: MotionChunk, new: MotionChunk) -> None:
        self._frame = 0
        (before, last), (first, second) = (part.rotations[:2].astype(np.float64) for part in (old, new))
        old_step, new_step = _rotation_between(before, last), _rotation_between(first, second)
        back = quaternion_multiply(quaternion_from_axis_angle(-new_step), first)  # one frame before the new motion
        self._rotation = _rotation_between(back, last)
        self._spin = _at_most((old_step - new_step) * FRAME_RATE_HZ, GREATEST_START)
        size = np.linalg.norm(self._rotation, axis=-1)
        self._seconds = np.maximum(
            np.clip(size / math.pi * 2 * LONGEST_S, SHORTEST_S, LONGEST_S), _STEEPEST * size / FASTEST
        )
        old_root, new_root = old.root.astype(np.float64), new.root[:2].astype(np.float64)
        self._shift = old_root[1] - (2 * new_root[0] - new_root[1])
        speed = ((old_root[1] - old_root[0]) - (new_root[1] - new_root[0])) * FRAME_RATE_HZ
        self._drift = _at_most(speed, ROOT_FASTEST)
        far = float(np.linalg.norm(self._shift))
        self._root_seconds = max(LONGEST_S, _STEEPEST * far / ROOT_FASTEST)
        has_face = old.face is not None and new.face is not None
        self._face = old.face[-1] - new.face[0] if has_face else None  # type: ignore[index]
        self._longest = max(float(self._seconds.max(initial=0)), self._root_seconds)

    @property
    def is_over(self) -> bool:
        return self._frame / FRAME_RATE_HZ >= self._longest

    def apply(self, chunk: MotionChunk) -> MotionChunk:
        """The chunk plus the offset of its frames."""
        frames = len(chunk.root)
        time = (np.arange(self._frame, self._frame + frames) + 1) / FRAME_RATE_HZ
        self._frame += frames
        value, slope = _decay(time[:, None] / self._seconds)
        offset = self._rotation * value[..., None] + self._spin * (slope * self._seconds)[..., None]
        blended = quaternion_multiply(quaternion_from_axis_angle(offset), chunk.rotations.astype(np.float64))
        value, slope = _decay(time[:, None] / self._root_seconds)
        root = chunk.root + self._shift * value + self._drift * slope * self._root_seconds
        face = chunk.face
        if face is not None and self._face is not None:
            share = _decay(time[:, None] / FACE_SECONDS)[0]
            face = np.clip(face + self._face * share, 0, 1).astype(np.float32)
        rotations = standardize(unit(blended)).astype(np.float32)
        return MotionChunk(rotations, root.astype(np.float32), face)


def _decay(share: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """Decay of a unit difference and of a unit speed; both are quintics that end at rest where `share` is 1."""
    s = np.minimum(share, 1)
    return 1 - smootherstep(s), s * (1 - s) ** 3 * (1 + 3 * s)


def _rotation_between(a: Float[Array, "j 4"], b: Float[Array, "j 4"]) -> Float[Array, "j 3"]:
    """Rotation vector, in the parent's axes, that takes a to b."""
    return axis_angle_from_quaternion(quaternion_multiply(unit(b), quaternion_conjugate(unit(a))))


def _at_most(vector: Float[Array, "... 3"], size: float) -> Float[Array, "... 3"]:
    """The vectors, shortened to `size` where they are longer."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    shortened: Array = vector * np.minimum(1, size / np.maximum(length, 1e-9))
    return shortened
