"""Motion at the display's rate: a stream of 30 fps chunks becomes one of 60 fps, or of any other rate.

Between two frames runs a cubic through both, with the slopes that their neighbours give (Catmull-Rom): rotations as
quaternions of one hemisphere, normalised; root and face as they are. So angular velocity has no step, at frames or at
chunk borders, and every source frame is met exactly where the two rates share an instant. The slope at a frame needs
the next one, so a frame is passed on when the one after it is known: one source frame of delay (33 ms at 30 fps), no
more. `finish` passes on the rest. Not in the paper.

    screen = StreamInterpolator(60)
    for chunk in session:
        show(screen.push(chunk))     # 13 frames of the first chunk, 16 of every other
    show(screen.finish())
"""

from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ

from .kinematics.resample import align_signs
from .motion_chunk import MotionChunk, join

Array = np.ndarray


class StreamInterpolator:
    """One session's frames at another rate."""

    def __init__(self, fps: float, source_fps: float = FRAME_RATE_HZ) -> None:
        """Raises MotionError for a rate that cannot be."""
        if not (0 < fps <= 1000 and 0 < source_fps <= 1000):
            raise MotionError(f"cannot go from {source_fps} to {fps} frames per second; choose 1 to 1000")
        self._step = frame_ratio(source_fps, fps)  # source frames per new frame
        self.reset()

    def reset(self) -> None:
        """Forget the stream; the next frame pushed is a first one."""
        self._past: MotionChunk | None = None  # the frames still needed, up to three; the last is the newest
        self._first = 0  # index of the first of them in the stream
        self._made = 0

    def push(self, chunk: MotionChunk) -> MotionChunk:
        """New frames as far as they are certain: up to the last source frame but one."""
        known = chunk if self._past is None else join([self._past, chunk])
        end = self._first + len(known.root) - 1
        made = self._between(known, end)
        keep = min(3, len(known.root))
        self._past, self._first = _cut(known, slice(len(known.root) - keep, None)), end + 1 - keep
        return made

    def finish(self) -> MotionChunk:
        """The frames up to the last source frame, which is continued straight; the next push begins anew."""
        if self._past is None:
            raise MotionError("nothing was pushed, so there is nothing to finish; push a chunk first")
        last = _cut(self._past, slice(-2, None))
        turns, places, face = _aligned(last)
        on = None if face is None else 2 * face[-1:] - face[:1]
        ahead = MotionChunk(2 * turns[-1:] - turns[:1], 2 * places[-1:] - places[:1], on)
        known = join([self._past, ahead])
        made = self._between(known, self._first + len(known.root) - 1)
        self.reset()
        return made

    def _between(self, known: MotionChunk, end: int) -> MotionChunk:
        """New frames from the next one on, before and at source frame `end` - 1; frames beyond stay unmade."""
        count = max(0, int((end - 1) / self._step) + 1 - self._made) if end else 0
        at = (np.arange(self._made, self._made + count) * self._step.numerator) / self._step.denominator
        exact = np.arange(self._made, self._made + count) * self._step.numerator
        self._made += count
        index = np.minimum(exact // self._step.denominator, max(end - 1, 0))
        share = at - index
        turns, places, curves = _aligned(known)
        rotations, root = (_cubic(v, index - self._first, share) for v in (turns, places))
        face = None if curves is None else np.clip(_cubic(curves, index - self._first, share), 0, 1)
        rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
        is_source, source = share == 0, known.rotations[np.minimum(index - self._first, len(known.root) - 1)]
        signed = np.where(rotations[..., :1] < 0, -rotations, rotations).astype(np.float32)
        rotations = np.where(is_source[:, None, None], source, signed)
        return MotionChunk(rotations, root.astype(np.float32), None if face is None else face.astype(np.float32))


def frame_ratio(source_fps: float, fps: float) -> Fraction:
    """Source frames per new frame, exactly; 23.976, 29.97 and 59.94 are the film rates over 1001."""
    return _fraction(source_fps) / _fraction(fps)


def _fraction(fps: float) -> Fraction:
    film = Fraction(round(fps * 1001), 1001)
    is_film = film.numerator % 1000 == 0 and abs(float(film) - fps) < 5e-3 and fps != round(fps)
    return film if is_film else Fraction(fps).limit_denominator(1001)


def _cubic(values: Float[Array, "t ..."], index: Int[Array, " n"], share: Float[Array, " n"]) -> Float[Array, "n ..."]:
    """Catmull-Rom between frames `index` and `index` + 1; before the first frame it goes straight."""
    before = values[:1] * 2 - values[1:2] if len(values) > 1 else values
    wide = np.concatenate([before, values, values[-1:], values[-1:]]).astype(np.float64)
    a, b, c, d = (wide[index + k] for k in range(4))
    u = share.reshape(-1, *([1] * (values.ndim - 1)))
    curve: Array = b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    return curve


def _aligned(chunk: MotionChunk) -> MotionChunk:
    """Quaternions with signs so that none points away from the one before."""
    return chunk._replace(rotations=align_signs(chunk.rotations))


def _cut(chunk: MotionChunk, part: slice) -> MotionChunk:
    face = None if chunk.face is None else chunk.face[part]
    return MotionChunk(chunk.rotations[part], chunk.root[part], face)
