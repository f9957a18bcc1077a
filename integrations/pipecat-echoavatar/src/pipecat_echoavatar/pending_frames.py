"""Keep frames in order: a frame that came behind speech stays behind it while the speech waits for its motion."""

from collections import deque
from collections.abc import Iterator

from pipecat.frames.frames import Frame, TTSAudioRawFrame


class PendingFrames:
    """Frames, ordered by the speech in front of them, which is counted in samples at 24 kHz over all utterances."""

    def __init__(self) -> None:
        self.received = 0  # samples of speech that came in
        self._released = 0  # samples of speech that were released
        self._frames: deque[tuple[int, Frame]] = deque()
        self._ends: dict[int, int] = {}  # by utterance: `received` at its end

    @property
    def is_empty(self) -> bool:
        """Whether nothing is pending, so that a frame may pass at once."""
        return not self._frames and self._released >= self.received

    def add(self, frame: Frame, samples: int = 0) -> None:
        """Add a frame. A speech frame of `samples` is only kept in case its motion never comes."""
        self.received += samples
        self._frames.append((self.received, frame))

    def mark_end(self, seg: int) -> None:
        """Note the end of an utterance."""
        self._ends[seg] = self.received

    def release(self, samples: int) -> Iterator[Frame]:
        """Speech of this length was released with its motion; yields the frames that may follow."""
        return self._release(min(self.received, self._released + samples))

    def finish(self, seg: int) -> Iterator[Frame]:
        """An utterance was released completely; yields the frames that may follow."""
        ends = [self._ends.pop(known) for known in list(self._ends) if known <= seg]
        return self._release(max([self._released, *ends]))

    def interrupt(self) -> list[Frame]:
        """Drop all speech, and return the frames that must be delivered even after an interruption."""
        kept = [frame for _, frame in self._frames if not frame.interruptible]
        self._released = self.received
        self._frames.clear()
        self._ends.clear()
        return kept

    def drain(self) -> list[Frame]:
        """Remove and return everything, the speech as it came."""
        frames = [frame for _, frame in self._frames]
        self.interrupt()
        return frames

    def _release(self, released: int) -> Iterator[Frame]:
        self._released = released
        while self._frames and self._frames[0][0] <= released:
            frame = self._frames.popleft()[1]
            if not isinstance(frame, TTSAudioRawFrame):
                yield frame
