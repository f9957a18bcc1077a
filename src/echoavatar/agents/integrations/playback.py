"""What a bridge puts out (chunks of motion with their sound), and an estimate of how far a framework has played it.

The estimate comes from the framework's reports of written sound, and from the wall clock in between. Frameworks receive
sound ahead of time, and most report little about when it is heard. During silence no reports come, so the clock must
run on without them. While a framework that does report is stuck, the clock must stop.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from echoavatar.engine import Playhead
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.messages import ActionStatus, Flush, Motion, Ready, Sound, State

_FRAME_BYTES = 2 * SAMPLES_PER_FRAME
GRACE_S = 0.1  # a framework writes in blocks; after a block it is assumed to play on for this long
REST_S = 0.06  # up to this much may stay unwritten until more sound comes: less than a block


class AvatarChunk(NamedTuple):
    """Some frames of motion and the sound to play with them."""

    motion: Motion
    pcm: bytes  # s16le mono, 24 kHz; empty if there is nothing to hear, or if the sound was released before
    at: int  # its clock
    seg: int  # utterance that speaks here; 0: none
    is_revision: bool = False  # replaces motion released before, so it must overtake what a framework has queued

    def messages(self) -> tuple[Motion | Sound, ...]:
        """Motion and sound as a session's messages; a chunk without sound is silent."""
        if self.is_revision:
            return (self.motion,)
        pcm = self.pcm or bytes(self.motion.frames * _FRAME_BYTES)
        return self.motion, Sound(at=self.at, epoch=self.motion.epoch, seg=self.seg, pcm=pcm)


class Flushed(NamedTuple):
    """Everything released from `flush.at` on is void: it was interrupted, or is remade for a gesture."""

    flush: Flush
    is_interruption: bool


class UtteranceDone(NamedTuple):
    """An utterance was released completely; its last sample is heard at clock `at`."""

    seg: int
    at: int


Event = AvatarChunk | Flushed | UtteranceDone | Ready | State | ActionStatus


def make_chunk(motion: Motion | None, sound: Sound, *, released_to: int, cut_seg: int) -> AvatarChunk:
    """Combine motion and sound of one clock; a slow connection may have dropped the motion, never the sound.

    Sound up to clock `released_to` was released before; a chunk there is remade motion for a gesture and brings no
    sound. Utterances up to `cut_seg` were cut off, and the rest of their last chunk is silence.
    """
    if motion is None or motion.at != sound.at:
        frames = len(sound.pcm) // _FRAME_BYTES
        motion = Motion(at=sound.at, epoch=sound.epoch, frames=frames, rotations=b"", root=b"", face=b"", state="idle")
    seg = sound.seg if sound.seg > cut_seg else 0
    pcm = sound.pcm if seg or any(sound.pcm) else b""
    is_revision = sound.at < released_to
    return AvatarChunk(motion, b"" if is_revision else pcm, sound.at, seg, is_revision)


@dataclass
class _Span:
    start: int  # its clock
    samples: int
    written: float = 0.0  # in samples


class Playback:
    """Estimates the clock of the first sample that was not heard; times are seconds of any monotonic clock."""

    def __init__(self, at: int, now: float) -> None:
        self._playhead = Playhead()
        self._spans: deque[_Span] = deque()  # sound that is not written completely
        self._reports = False
        self.jump(at, now)

    def pushed(self, start: int, samples: int, *, audible: bool) -> None:
        """A stretch of the session was released. A stretch that is not audible was not handed to the framework."""
        self.end = start + samples
        if audible:
            self._spans.append(_Span(start, samples))

    def wrote(self, seconds: float, now: float) -> None:
        """The framework has written this much sound to its device or connection."""
        self._reports = True
        samples = seconds * SAMPLE_RATE_HZ
        while samples > 0 and self._spans:
            span = self._spans[0]
            part = min(samples, span.samples - span.written)
            span.written += part
            samples -= part
            self._move(span.start + round(span.written), now)
            if span.samples - span.written < 1:
                self._spans.popleft()

    def plays(self, at: int, now: float) -> None:
        """The framework knows that exactly this sample is being heard."""
        self._move(min(at, self.end), now)
        self._spans = deque(span for span in self._spans if span.start + span.samples > at)

    def position(self, now: float) -> int:
        """The clock of the first sample that was not heard."""
        self._playhead.advance(now, self._bound())
        return self._playhead.sample

    def jump(self, at: int, now: float) -> None:
        """Everything after `at` was discarded; the listener is at `at`."""
        self.end = at  # clock up to which there is something to play
        self._move(at, now)
        self._spans.clear()

    @property
    def is_sounding(self) -> bool:
        """Whether sound was released that may not have been heard yet."""
        return any(span.start + span.samples > self._playhead.sample for span in self._spans)

    def _move(self, at: int, now: float) -> None:
        self._playhead.advance(now, self.end)
        self._playhead.jump(at)

    def _bound(self) -> int:
        """The latest position that the wall clock may reach without a report."""
        if not self._reports:
            while self._spans and self._spans[0].start + self._spans[0].samples <= self._playhead.sample:
                self._spans.popleft()
            return self.end
        for span in self._spans:
            if span.samples - span.written > REST_S * SAMPLE_RATE_HZ:
                return min(self.end, span.start + round(span.written + GRACE_S * SAMPLE_RATE_HZ))
        return self.end
