"""What a session will hear: speech at any rate in, chunks of 24 kHz out, with music mixed under it.

Bounded: more speech than `INBOX_SECONDS` is refused, because it would be heard minutes late; nothing is ever dropped
silently. Agents deliver speech faster than real time, so the bound is generous.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..audio import StreamResampler
from ..errors import EchoAvatarError, InboxError
from ..timing import CHUNK, SAMPLE_RATE_HZ, ChunkSize
from .music import MusicPlayer

INBOX_SECONDS = 600
Samples = Float[np.ndarray, " s"]


class Heard(NamedTuple):
    """One chunk of sound as the avatar hears it: speech plus music."""

    speech: Samples
    music: Samples | None  # as it must be played; None where none plays
    voiced: bool  # whether any of the speech was pushed, rather than silence for a source that stalled

    @property
    def audio(self) -> Samples:
        """The mix."""
        return self.speech if self.music is None else self.speech + self.music


class Inbox:
    """Speech that waits, and the music player."""

    def __init__(self, chunk: ChunkSize = CHUNK) -> None:
        self.player = MusicPlayer(chunk)
        self._size = chunk.samples
        self._resampler: StreamResampler | None = None
        self._speech = np.zeros(0, np.float32)
        self._silence = 0  # samples at the end of the speech that are there for want of a source
        self._finished = False

    @property
    def seconds(self) -> float:
        """Speech that waits."""
        return len(self._speech) / SAMPLE_RATE_HZ

    @property
    def has_chunk(self) -> bool:
        """Whether a whole chunk of speech waits."""
        return len(self._speech) >= self._size

    def push(self, audio: Float[np.ndarray, "..."], rate: int) -> None:
        """Add speech.

        Raises:
            AudioError: samples or rate that cannot be.
            InboxError: too much is waiting.
            EchoAvatarError: the inbox is finished.
        """
        if self._finished:
            raise EchoAvatarError("this session is finished; open a new one to push more audio")
        if self.seconds + len(audio) / max(rate, 1) > INBOX_SECONDS:
            raise InboxError(
                f"more than {INBOX_SECONDS} s of audio are waiting; read motion from the session before pushing more"
            )
        if self._resampler is None or self._resampler.rate != rate:
            self._flush()
            self._resampler = StreamResampler(rate)
        self._add(self._resampler.push(audio))

    def stall(self) -> None:
        """The source is late: complete the chunk in hand with silence."""
        if not self.has_chunk:
            self._flush()
            missing = max(0, self._size - len(self._speech))
            self._speech = np.pad(self._speech, (0, missing))
            self._silence += missing

    def finish(self) -> None:
        """No more speech will come: the rest is completed with silence to a whole chunk."""
        if not self._finished:
            self._flush()
            self._speech = np.pad(self._speech, (0, -len(self._speech) % self._size))
            self._finished = True

    def take(self) -> Heard:
        """The next chunk; where less than a chunk of speech waits, silence follows it."""
        if not self.has_chunk:
            self.stall()
        speech, self._speech = self._speech[: self._size], self._speech[self._size :]
        silent = max(0, self._silence - len(self._speech))  # of this chunk
        self._silence -= silent
        voiced = silent < self._size
        return Heard(speech, self.player.next_chunk(speech), voiced)

    def give_back(self, speech: Samples, keep: int | None) -> None:
        """Speech that was taken stands in front again; with `keep` only so many samples stay in all, the rest goes."""
        self._speech = np.concatenate([speech, self._speech])
        if keep is not None:
            self._resampler = None
            self._silence = 0
            self._speech = self._speech[:keep]

    def _add(self, samples: Samples) -> None:
        if len(samples):
            self._speech = np.concatenate([self._speech, samples])
            self._silence = 0

    def _flush(self) -> None:
        if self._resampler is not None:
            self._add(self._resampler.flush())
            self._resampler = None
