"""Barge-in: the user interrupts, and the session goes on as if the unheard sound had never come.

This file decides; the queue, the music player, the playout buffer and the model's row hold the data that it moves. A
barge-in at sample `heard` (`interrupt`) and a change of plan that loses no sound (`replan`) both go back:

    part                 at once, when the session goes back          when the next chunk begins
    AudioQueue           reads again from the chunk of `heard`;
                         a barge-in also cuts what lies after it
    MusicPlayer          stands where it stood before that chunk
    PlayoutBuffer        drops motion after `heard`; new motion
                         will blend out of the pose shown there
    epoch                rises: what readers hold of it is void
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

A step of the model writes about a tenth of its row, so only the overwritten values are kept (`Patch`). Undoing the last
n steps, latest first, restores the state of n steps ago to the bit.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Int, Shaped
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.timing import SAMPLES_PER_FRAME, ChunkSize

from .audio_queue import AudioQueue
from .music import MusicPlayer, Playing
from .playout import PlayoutBuffer, first_frame_after

_WORDS = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}  # by size in bytes
SMALL = 4096  # elements; a smaller tensor is kept whole


class Patch(NamedTuple):
    """Overwritten values of one tensor's row: all of it, or those at `where` of the flattened row."""

    where: Int[Tensor, " n"] | None
    values: Shaped[Tensor, " n"]


def changes(before: list[Tensor], state: StreamState, row: int) -> list[Patch]:
    """The values that a step overwrote in a row; `before` is the state's `snapshot` from before the step."""
    pairs = zip(before, state.tensors(), strict=True)
    return [_patch(old[row : row + 1].reshape(-1), _row(new, row)) for old, new in pairs]


def undo(patches: list[Patch], state: StreamState, row: int) -> None:
    """Restore the row to what it was before the step that made these patches."""
    for tensor, patch in zip(state.tensors(), patches, strict=True):
        flat = _row(tensor, row)
        if patch.where is None:
            flat.copy_(patch.values)
        else:
            flat[patch.where] = patch.values


def _row(tensor: Tensor, row: int) -> Tensor:
    """The row, flat, as a view."""
    return tensor[row : row + 1].view(-1)


def _patch(old: Tensor, new: Tensor) -> Patch:
    if old.numel() < SMALL:
        return Patch(None, old.clone())
    different = _bits(old) != _bits(new)
    if old.device.type == "cpu":
        where = torch.from_numpy(np.flatnonzero(different.numpy()))  # torch's own nonzero takes twice as long
    else:
        where = different.nonzero().flatten()
    return Patch(where, old[where]) if 2 * len(where) < old.numel() else Patch(None, old.clone())


def _bits(values: Tensor) -> Int[Tensor, " n"]:
    """The values' bit patterns as integers, which tell -0.0 from 0.0 and compare NaN."""
    return values.view(_WORDS[values.element_size()])


class Interruption(NamedTuple):
    """What a barge-in did."""

    at: int  # sample at which new motion begins
    epoch: int  # of the new motion
    utterance: int  # that was cut off, 0 for none
    heard: int  # samples of it that were heard, at 24 kHz


class _Step(NamedTuple):
    """A chunk that was made, and how to unmake it."""

    music: Playing  # the music player before it
    patches: list[Patch]


class _InFlight(NamedTuple):
    epoch: int
    music: Playing


class BargeIn:
    """Which chunk is next, which can be taken back, and how. The session holds its lock around every call."""

    def __init__(
        self, queue: AudioQueue, music: MusicPlayer, playout: PlayoutBuffer, *, chunk: ChunkSize, rewind: int
    ) -> None:
        self.epoch = 0
        self.played: int | None = None  # the sample that the player shows, if it says so
        self._queue, self._music, self._playout = queue, music, playout
        self._size, self._rewind = chunk.samples, rewind
        self._steps: deque[_Step] = deque()  # the latest that can be undone
        self._made = 0  # chunks that the model's row has taken in
        self._target: int | None = None  # the chunk before which the row must go back
        self._in_flight: _InFlight | None = None

    @property
    def next_chunk(self) -> int:
        """Number of the first chunk that is neither made nor being made."""
        if self._target is not None:
            return self._target
        return self._made + (self._in_flight is not None)

    def begin(self) -> tuple[int, list[list[Patch]]]:
        """A chunk is being made now: its number, and the steps to undo before it, latest first."""
        undone: list[list[Patch]] = []
        if self._target is not None:
            undone = [self._steps.pop().patches for _ in range(self._made - self._target)]
            self._made, self._target = self._target, None
        self._in_flight = _InFlight(self.epoch, self._music.now)
        return self._made, undone

    def end(self, patches: list[Patch]) -> bool:
        """The chunk is made; returns whether it is to be shown, because it was not taken back meanwhile."""
        assert self._in_flight is not None
        epoch, music = self._in_flight
        self._in_flight = None
        self._made += 1
        self._steps.append(_Step(music, patches))
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
        """Make motion again that lies more than `most` chunks ahead of the player; no sound is lost."""
        if self.played is None or self._rewind == 0:
            return
        border = -(-self.played // self._size) + 1
        if self.next_chunk * self._size - self.played > most * self._size and border < self.next_chunk:
            self._go_back(border * self._size)

    def _go_back(self, sample: int) -> int:
        """To a sample, or as near to it as the steps that are kept allow; returns the sample."""
        oldest = self._made - len(self._steps)
        border = max(sample // self._size, oldest)
        sample = max(sample, border * self._size)
        if border < self._made:
            self._music.rewind(border, self._steps[border - oldest].music)
        elif self._in_flight is not None:
            self._music.rewind(border, self._in_flight.music)
        self._queue.go_back(border)
        self._target = border
        self.played = None if self.played is None else min(self.played, sample)
        self.epoch += 1
        self._playout.go_back(sample)
        return sample
