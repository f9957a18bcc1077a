"""Motion at the display's rate: a stream of 30 fps chunks becomes one of 60 fps, or of any other rate.

Frames are interpolated by Catmull-Rom cubics: rotations as normalised quaternions of one hemisphere, root and face as
they are. Angular velocity therefore has no step, neither at frames nor at chunk borders. Where both rates share an
instant, the source frame is copied exactly. The slope at a frame needs the frame after it, so the stream is one source
frame late (33 ms at 30 fps). `finish` returns what is left. Not in the paper.

    screen = StreamInterpolator(60)
    for chunk in session:
        show(screen.push(chunk))     # 13 frames of the first chunk, 16 of every other
    show(screen.finish())
"""

import numpy as np

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ

from .kinematics.motion import SLOWEST_HZ, align_signs, catmull_rom, frame_ratio
from .motion_chunk import MotionChunk, join


class StreamInterpolator:
    """One session's frames at another rate."""

    def __init__(self, fps: float) -> None:
        """Raises MotionError for a rate outside 0.1 to 1000."""
        if not SLOWEST_HZ <= fps <= 1000:
            raise MotionError(f"cannot go to {fps} frames per second; choose {SLOWEST_HZ} to 1000")
        self._step = frame_ratio(FRAME_RATE_HZ, fps)  # source frames per new frame
        self.reset()

    def reset(self) -> None:
        """Forget the stream; the next frame pushed begins a new one."""
        self._past: MotionChunk | None = None  # the frames still needed, up to three; the last is the newest
        self._first = 0  # index of the first of them in the stream
        self._made = 0

    def push(self, chunk: MotionChunk) -> MotionChunk:
        """The new frames that are settled: those up to the last source frame but one."""
        known = chunk if self._past is None else join([self._past, chunk])
        end = self._first + len(known.root) - 1
        made = self._between(known, end)
        keep = min(3, len(known.root))
        self._past, self._first = known.part(-keep), end + 1 - keep
        return made

    def finish(self) -> MotionChunk:
        """The rest, up to the last source frame; the next push begins anew. Raises MotionError: nothing was pushed."""
        if self._past is None:
            raise MotionError("nothing was pushed, so there is nothing to finish; push a chunk first")
        last = self._past.part(-2)
        rotations, root, face = _aligned(last)
        next_face = None if face is None else 2 * face[-1:] - face[:1]
        ahead = MotionChunk(2 * rotations[-1:] - rotations[:1], 2 * root[-1:] - root[:1], next_face)
        known = join([self._past, ahead])
        made = self._between(known, self._first + len(known.root) - 1)
        self.reset()
        return made

    def _between(self, known: MotionChunk, end: int) -> MotionChunk:
        """The new frames that are due, up to source frame `end` - 1 (included)."""
        count = max(0, int((end - 1) / self._step) + 1 - self._made) if end else 0
        exact = np.arange(self._made, self._made + count) * self._step.numerator
        self._made += count
        index = np.minimum(exact // self._step.denominator, max(end - 1, 0))
        share = exact / self._step.denominator - index
        aligned, place = _aligned(known), index - self._first
        rotations, root = (catmull_rom(values, place, share) for values in (aligned.rotations, aligned.root))
        rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
        is_source, source = share == 0, known.rotations[np.minimum(place, len(known.root) - 1)]
        signed = np.where(rotations[..., :1] < 0, -rotations, rotations).astype(np.float32)
        rotations = np.where(is_source[:, None, None], source, signed)
        curves = aligned.face
        face = None if curves is None else np.clip(catmull_rom(curves, place, share), 0, 1).astype(np.float32)
        return MotionChunk(rotations, root.astype(np.float32), face)


def _aligned(chunk: MotionChunk) -> MotionChunk:
    """Quaternions with signs so that none points away from the one before."""
    return chunk._replace(rotations=align_signs(chunk.rotations))
