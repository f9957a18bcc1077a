"""The playout buffer: motion on its way to the reader, and the blend out of the pose shown when a barge-in comes.

After a barge-in the new motion begins at the first frame after the last sample heard, inside its chunk. It starts from
the old pose and speed, as an offset that dies away (`motion.inertial`). If only one frame of the chunk is left, the
old motion coasts through it and the blend begins with the next chunk, because a speed takes two frames.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.motion.inertial import InertialBlend
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.timing import CHUNK, SAMPLES_PER_FRAME, ChunkSize

from .music import Heard

COASTING = 0.5  # share of its speed that motion keeps in that one frame


class Delivery(NamedTuple):
    """Motion with its place on the session's clock."""

    motion: MotionChunk
    start: int  # sample of its first frame
    epoch: int  # if higher than that of the delivery before, everything delivered from `start` on is void
    audio: Float[np.ndarray, " s"]  # the sound of these frames: speech and music
    music: Float[np.ndarray, " s"] | None  # the music in it
    source: str  # "action", "speech", "music" or "idle"


class PlayoutBuffer:
    """Motion of one session that the reader has not taken, and the shown chunks that can be taken back."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self._frames = chunk.frames
        self.taken = 0  # sample up to which motion was taken
        self.end = 0  # sample up to which there is motion
        self.source = "idle"
        self.waiting: deque[Delivery] = deque()  # for the reader
        self._recent: dict[int, MotionChunk] = {}  # by chunk, as shown
        self._blend = InertialBlend()
        self._fresh = 0  # first frame that may be new
        self._shown: MotionChunk | None = None  # the two frames before it, until the blend has begun

    def take(self) -> Delivery | None:
        """The next delivery, or None."""
        if not self.waiting:
            return None
        delivery = self.waiting.popleft()
        self.taken = delivery.start + len(delivery.motion.root) * SAMPLES_PER_FRAME
        return delivery

    def show(self, chunk: int, motion: MotionChunk, heard: Heard, source: str, *, epoch: int, memory: int) -> None:
        """Add a whole chunk; frames of it shown before a barge-in stay. `memory` chunks before it can be taken back."""
        skip = max(0, self._fresh - chunk * self._frames)
        new = self._blended(motion.part(skip))
        shown = self._recent.get(chunk)
        whole = new if shown is None else join([shown, new])
        self._recent[chunk] = whole
        for old in [at for at in self._recent if at < chunk - memory]:
            del self._recent[old]
        self.end, self.source = (chunk + 1) * self._frames * SAMPLES_PER_FRAME, source
        if not len(new.root):
            return
        cut = skip * SAMPLES_PER_FRAME
        start = chunk * self._frames * SAMPLES_PER_FRAME + cut
        music = None if heard.music is None else heard.music[cut:]
        self.waiting.append(Delivery(new, start, epoch, heard.audio[cut:], music, source))

    def go_back(self, sample: int) -> None:
        """Take back all motion after this sample."""
        self._fresh = first_frame_after(sample)
        self.end, self.taken = sample, min(self.taken, sample)
        for chunk in list(self._recent):
            left = self._fresh - chunk * self._frames
            if left <= 0:
                del self._recent[chunk]
            elif left < len(self._recent[chunk].root):
                self._recent[chunk] = self._recent[chunk].part(0, left)
        self._shown = self._last_two()
        self._blend = InertialBlend()
        kept = [_until(delivery, self._fresh) for delivery in self.waiting]
        self.waiting = deque(delivery for delivery in kept if len(delivery.motion.root))

    def _last_two(self) -> MotionChunk | None:
        chunks = [self._recent[chunk] for chunk in sorted(self._recent)[-2:]]
        chunks = [chunk for chunk in chunks if len(chunk.root)]
        if not chunks:
            return None
        last = join(chunks)
        return join([last, last]) if len(last.root) == 1 else last.part(len(last.root) - 2)

    def _blended(self, new: MotionChunk) -> MotionChunk:
        if not len(new.root):
            return new
        if self._shown is not None:
            if len(new.root) == 1:
                coasted = _coasting(self._shown, new)
                self._shown = join([self._shown.part(1, 2), coasted])
                return coasted
            self._blend.begin(self._shown)
            self._shown = None
        return self._blend.step(new)


def first_frame_after(sample: int) -> int:
    """The first frame that does not begin before this sample."""
    return -(-sample // SAMPLES_PER_FRAME)


def _until(delivery: Delivery, frame: int) -> Delivery:
    """The part of a delivery before a frame."""
    left = max(0, frame - delivery.start // SAMPLES_PER_FRAME)
    samples = left * SAMPLES_PER_FRAME
    music = None if delivery.music is None else delivery.music[:samples]
    return delivery._replace(motion=delivery.motion.part(0, left), audio=delivery.audio[:samples], music=music)


def _coasting(shown: MotionChunk, new: MotionChunk) -> MotionChunk:
    """One more frame after the two that were shown, at a lower speed."""
    before, last = shown.rotations[-2:-1], shown.rotations[-1:]
    before = np.where((before * last).sum(-1, keepdims=True) < 0, -before, before)
    rotations = last + COASTING * (last - before)
    rotations = rotations / np.maximum(np.linalg.norm(rotations, axis=-1, keepdims=True), 1e-9)
    root = shown.root[-1:] + COASTING * (shown.root[-1:] - shown.root[-2:-1])
    face = None if new.face is None or shown.face is None else shown.face[-1:]
    return MotionChunk(rotations.astype(np.float32), root.astype(np.float32), face)
