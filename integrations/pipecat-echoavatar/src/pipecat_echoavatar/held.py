"""Frames that came behind speech stay behind it, however long the speech waits for its motion."""

from collections import deque
from collections.abc import Iterator

from pipecat.frames.frames import Frame, TTSAudioRawFrame


class Held:
    """Frames by the speech in front of them, counted in samples at 24 kHz over all utterances."""

    def __init__(self) -> None:
        self.said = 0  # samples that came
        self._left = 0  # samples that left
        self._frames: deque[tuple[int, Frame]] = deque()
        self._ends: dict[int, int] = {}  # by utterance: what had been said at its end

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits: a frame may pass at once."""
        return not self._frames and self._left >= self.said

    def hold(self, frame: Frame, samples: int = 0) -> None:
        """A frame came; of speech, `samples` long: it stands for itself until its sound has left with motion."""
        self.said += samples
        self._frames.append((self.said, frame))

    def end(self, seg: int) -> None:
        """An utterance is complete."""
        self._ends[seg] = self.said

    def left(self, samples: int) -> Iterator[Frame]:
        """So much speech left with its motion; what stood behind it may follow."""
        return self._release(min(self.said, self._left + samples))

    def over(self, seg: int) -> Iterator[Frame]:
        """All of an utterance left."""
        ends = [self._ends.pop(known) for known in list(self._ends) if known <= seg]
        return self._release(max([self._left, *ends]))

    def cut(self) -> list[Frame]:
        """An interruption: all speech is void; what must be delivered all the same."""
        kept = [frame for _, frame in self._frames if not frame.interruptible]
        self._left = self.said
        self._frames.clear()
        self._ends.clear()
        return kept

    def give_up(self) -> list[Frame]:
        """Everything, the speech as it came."""
        frames = [frame for _, frame in self._frames]
        self.cut()
        return frames

    def _release(self, left: int) -> Iterator[Frame]:
        self._left = left
        while self._frames and self._frames[0][0] <= left:
            frame = self._frames.popleft()[1]
            if not isinstance(frame, TTSAudioRawFrame):
                yield frame
