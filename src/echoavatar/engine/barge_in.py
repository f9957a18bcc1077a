"""Barge-in: the user interrupts, and the session goes on as if the unheard sound had never come.

This file decides; the queue, the music player, the playout buffer and the model's row hold the data that it moves. A
barge-in at sample `heard` (`interrupt`) and a change of plan that loses no sound (`replan`) both go back:

    part                 at once, when the session goes back          when the next chunk begins
    AudioQueue           reads again from the chunk of `heard`;
                         a barge-in also cuts what lies after it
    MusicPlayer          stands where it stood before that chunk
    PlayoutBuffer        drops motion after `heard`; new motion
                         will blend out of the pose shown there
    epoch                rises: messages of the older one are void
    model's row                                                       steps after that chunk are undone

The row may only be touched by the thread that steps the session, so going back is recorded as a target and carried
out later. A chunk may be in the making when that happens; it is finished, never shown, and undone with the others:

                   begin                      end
      SETTLED --------------> MAKING --------------------> SETTLED
         |                       |
         | go back               | go back
         v         begin, undo   v            end
      BEHIND --------------> MAKING   (STALE) -----------> BEHIND

    SETTLED   no target, nothing in flight          BEHIND   a target, nothing in flight
    MAKING    a chunk in flight, of this epoch      STALE    a target, and a chunk in flight of an older epoch

Going back again in BEHIND or STALE moves the target. The server adds what clients see: it sends `flush` with the
values of `Interruption`, drops queued messages after it and moves its playback clock to `heard` (`server/session.py`).
"""

from collections import deque
from typing import NamedTuple

from echoavatar.timing import SAMPLES_PER_FRAME, ChunkSize

from .audio_queue import AudioQueue
from .music import MusicPlayer, Playing
from .pipeline.undo import Patch
from .playout import PlayoutBuffer, first_frame_after


class Interruption(NamedTuple):
    """What a barge-in did."""

    at: int  # sample at which new motion begins
    epoch: int  # of the new motion
    utterance: int  # the one that was cut off, 0 for none
    heard: int  # how many of its samples were heard, at 24 kHz


class _Step(NamedTuple):
    """A chunk that was made, and how to unmake it."""

    music: Playing  # the music player before it
    patch: Patch


class BargeIn:
    """Which chunk is next, which can be taken back, and how. The session holds its lock around every call."""

    def __init__(
        self, queue: AudioQueue, music: MusicPlayer, playout: PlayoutBuffer, *, chunk: ChunkSize, rewind: int
    ) -> None:
        self.epoch = 0
        self.played: int | None = None  # the sample that the player shows, if it reports that
        self._queue, self._music, self._playout = queue, music, playout
        self._size, self._rewind = chunk.samples, rewind
        self._steps: deque[_Step] = deque()  # the latest that can be undone
        self._made = 0  # chunks that the model's row has taken in
        self._target: int | None = None  # the chunk before which the row must go back
        self._in_flight: tuple[int, Playing] | None = None  # epoch of the chunk being made, the music player before it

    @property
    def next_chunk(self) -> int:
        """Number of the first chunk that is neither made nor being made."""
        if self._target is not None:
            return self._target
        return self._made + (self._in_flight is not None)

    def begin(self) -> tuple[int, list[Patch]]:
        """A chunk is being made now: its number, and the steps to undo before it, latest first."""
        undone: list[Patch] = []
        if self._target is not None:
            undone = [self._steps.pop().patch for _ in range(self._made - self._target)]
            self._made, self._target = self._target, None
        self._in_flight = self.epoch, self._music.now
        return self._made, undone

    def end(self, patch: Patch) -> bool:
        """The chunk is made; returns whether it is to be shown, because it was not taken back meanwhile."""
        assert self._in_flight is not None
        epoch, music = self._in_flight
        self._in_flight = None
        self._made += 1
        self._steps.append(_Step(music, patch))
        if epoch != self.epoch:
            return False
        while len(self._steps) > self._rewind:
            self._steps.popleft()
        return True

    def interrupt(self, heard: int | None, last: int | None = None) -> Interruption:
        """Nothing after sample `heard` was heard (None: after the motion that was taken).

        Utterances up to `last` are dropped, also those that wait (None: all).
        """
        end = self._playout.taken if heard is None else min(heard, self._playout.end)
        sample = self._go_back(max(0, end))
        utterance, count = self._queue.cut(sample, last, heard=heard or 0)
        return Interruption(first_frame_after(sample) * SAMPLES_PER_FRAME, self.epoch, utterance, count)

    def replan(self, most: int) -> None:
        """If motion is over `most` chunks ahead of the player, make it again from near the player; no sound is lost."""
        if self.played is None or self._rewind == 0:
            return
        border = -(-self.played // self._size) + 1
        if self.next_chunk * self._size - self.played > most * self._size and border < self.next_chunk:
            self._go_back(border * self._size)

    def _go_back(self, sample: int) -> int:
        """Go back to a sample, or as near to it as the kept steps allow; returns the sample reached."""
        oldest = self._made - len(self._steps)
        border = max(sample // self._size, oldest)
        sample = max(sample, border * self._size)
        if border < self._made:
            self._music.rewind(border, self._steps[border - oldest].music)
        elif self._in_flight is not None:
            self._music.rewind(border, self._in_flight[1])
        self._queue.go_back(border)
        self._target = border
        self.played = None if self.played is None else min(self.played, sample)
        self.epoch += 1
        self._playout.go_back(sample)
        return sample
