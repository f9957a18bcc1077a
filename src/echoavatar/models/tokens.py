"""Codes, vocabulary ids, and the orders in which audio and motion share one sequence.

Paper, Audio Driven Motion Generation: the multi-layer RVQ indices of audio and motion are flattened into one
autoregressive stream (after MusicGen). One time step of motion is 3 Q ids in the order of the segments: the layers of
the lower body, then of the upper body, then of the hands. Position k of the motion stream may hold segment k mod 3 Q
only, so predictions are grouped by segment.

An order says how audio and motion ids share a sequence. `prefix` (paper, Settings): the audio of the whole window, then
its motion. `depth` (ours; the shipped generator's): the ids of one motion time step after those of another, for a
generator that reads a time step at once. `interleaved` (ours): start id, then per chunk 40 audio ids and 6 Q motion
ids; every motion position sees exactly the audio it sees live. It serves the lab's table `layouts`, which shows what a
transformer loses or gains when it does not read the paper's window anew at every step.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK

PARTS = 3  # lower body, upper body, hands
UPPER = 1  # the part whose first-layer codes a directive may name


class TokenLayout(Config):
    """Rows of the vocabulary. The defaults are the compact vocabulary of our own models."""

    audio_layers: int = Field(default=2, gt=0, le=64, description="RVQ layers of the audio codec that are used")
    audio_codes: int = Field(default=512, gt=0, le=1 << 20, description="codes in each audio codebook")
    motion_layers: int = Field(default=4, gt=0, le=64, description="RVQ layers Q of each motion tokenizer")
    motion_codes: int = Field(default=512, gt=0, le=1 << 20, description="codes K in each motion codebook")
    parts: int = Field(default=PARTS, gt=0, le=64, description="motion tokenizers, one a body part; 1: the body whole")
    start_id: int = Field(default=0, ge=0, description="the id that opens a sequence")
    before_audio: tuple[int, ...] = Field(default=(1,), description="ids before the audio of a prefix prompt")
    before_motion: tuple[int, ...] = Field(default=(2,), description="ids between audio and motion of a prefix prompt")
    before_example: tuple[int, ...] = Field(
        default=(), description="ids that open a prefix prompt which shows an example; () if none ever does"
    )
    after_example: tuple[int, ...] = Field(default=(), description="ids between the example and `before_audio`")
    audio_base: int = Field(default=4, ge=0, description="id of code 0 in audio layer 0")
    motion_base: int = Field(default=4 + 2 * 512, ge=0, description="id of code 0 in segment 0")
    vocabulary: int = Field(default=4 + 2 * 512 + 12 * 512, gt=0, description="rows of the embedding table")

    @model_validator(mode="after")
    def _rows_do_not_overlap(self) -> Self:
        audio_end = self.audio_base + self.audio_layers * self.audio_codes
        if audio_end > self.motion_base:
            raise ValueError(f"audio rows end at {audio_end}, behind motion_base ({self.motion_base})")
        motion_end = self.motion_base + self.segments * self.motion_codes
        if motion_end > self.vocabulary:
            raise ValueError(f"motion rows end at {motion_end}, behind the vocabulary ({self.vocabulary})")
        specials = (self.start_id, *self.before_audio, *self.before_motion, *self.before_example)
        specials += self.after_example
        if max(specials) >= self.audio_base or min(specials) < 0:
            raise ValueError(f"special ids {specials} must lie below audio_base ({self.audio_base})")
        return self

    @property
    def segments(self) -> int:
        """Period 3 Q of the motion grammar (Q where the body is one part)."""
        return self.parts * self.motion_layers

    def segment_start(self, segment: int) -> int:
        """The id of code 0 in a segment of the motion grammar."""
        return self.motion_base + segment * self.motion_codes


@dataclass(frozen=True)
class SequenceOrder(ABC):
    """How windows of codes become one sequence of ids."""

    layout: TokenLayout
    window_chunks: int

    @property
    def audio_per_chunk(self) -> int:
        """Audio ids of a chunk: 40."""
        return AUDIO_FRAMES_PER_CHUNK * self.layout.audio_layers

    @property
    def motion_per_chunk(self) -> int:
        """Motion ids of a chunk: 6 Q."""
        return MOTION_TOKENS_PER_CHUNK * self.layout.segments

    @property
    def ids_per_chunk(self) -> int:
        """All ids of a chunk."""
        return self.audio_per_chunk + self.motion_per_chunk

    @property
    @abstractmethod
    def lookback(self) -> int | None:
        """Ids that a position sees, itself included; None where it sees the whole sequence."""


class Interleaved(SequenceOrder):
    """start, then per chunk 40 audio ids and 6 Q motion ids; a sliding band of `window_chunks` chunks."""

    @property
    def lookback(self) -> int:
        """How many ids attention looks back over: all ids of `window_chunks` chunks."""
        return self.window_chunks * self.ids_per_chunk


class Prefix(SequenceOrder):
    """The paper's order: all audio of the window, then all its motion; the window slides under every position."""

    @property
    def lookback(self) -> None:
        """Within a window everything earlier is seen."""
        return None


class Depth(SequenceOrder):
    """Per motion time step (here: a frame) its 20 audio ids and 3 Q motion ids; a position of the backbone is a frame.

    Each frame hears its own sound and the motion before it. Hidden states are one per code, frame after frame.
    """

    @property
    def lookback(self) -> int:
        """Frames that a position of the backbone sees, its own included."""
        return self.window_chunks * MOTION_TOKENS_PER_CHUNK


ORDERS: dict[Literal["interleaved", "prefix", "depth"], type[Interleaved | Prefix | Depth]] = {
    "interleaved": Interleaved,
    "prefix": Prefix,
    "depth": Depth,
}
