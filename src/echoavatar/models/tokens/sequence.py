"""The orders in which audio and motion share one sequence, behind one interface.

`interleaved` (ours, the default): start id, then per chunk 40 audio ids and 6 Q motion ids; every motion position sees
exactly the audio it sees live. `prefix` (paper, Settings): the audio of the whole window, then its motion. `depth`: the
ids of one motion time step after those of another, for a generator that reads a time step at once. All turn
windows of codes into ids, and say which position predicts which motion code: position k of the motion stream is
predicted in segment k mod 3 Q only, so predictions are grouped by segment.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK, exact_div

from .layout import TokenLayout


class Sequences(NamedTuple):
    """Training sequences: ids in, motion codes out. k = 3 Q segments, n motion time steps."""

    ids: Int[Tensor, "b t"]
    valid: Bool[Tensor, "b t"] | None  # None where every position counts
    predictors: Int[Tensor, "k n"]  # the position whose output predicts segment k of time step n
    targets: Int[Tensor, "b k n"]  # codes 0..K-1
    mask: Bool[Tensor, "b n"]  # time steps that carry loss
    asked: Int[Tensor, " n"] | None = None  # depth order: the time steps whose codes are asked for; None is all

    def asking(self, asked: Int[Tensor, " m"]) -> "Sequences":
        """The same ids, of which the codes of these time steps alone are asked for (depth order)."""
        predictors = self.predictors[:, : len(asked)]  # hidden states are counted among those asked
        return self._replace(
            predictors=predictors, targets=self.targets[:, :, asked], mask=self.mask[:, asked], asked=asked
        )


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

    @abstractmethod
    def heard(self, chunks: int) -> Int[Tensor, " f"]:
        """Of each audio frame of `chunks` chunks the position whose input is its last code."""

    @abstractmethod
    def build(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        target: Int[Tensor, "b n p q"],
        missing: Int[Tensor, " b"],
    ) -> Sequences:
        """Sequences of whole chunks: `context` codes are read, `target` codes are asked for.

        `missing` leading chunks of a row count as not there, as at the beginning of a session.
        """

    def _targets(self, target: Int[Tensor, "b n p q"]) -> Int[Tensor, "b k n"]:
        return target.long().flatten(2).transpose(1, 2)

    def _present(self, missing: Int[Tensor, " b"], chunks: int, each: int) -> Bool[Tensor, "b t"]:
        chunk = torch.arange(chunks, device=missing.device).repeat_interleave(each)
        return chunk >= missing[:, None]


class Interleaved(SequenceOrder):
    """start, then per chunk 40 audio ids and 6 Q motion ids; a sliding band of `window_chunks` chunks."""

    @property
    def lookback(self) -> int:
        """The band in ids: all ids of `window_chunks` chunks."""
        return self.window_chunks * self.ids_per_chunk

    def heard(self, chunks: int) -> Int[Tensor, " f"]:
        """See `SequenceOrder.heard`; the start id stands before everything."""
        within = (torch.arange(AUDIO_FRAMES_PER_CHUNK) + 1) * self.layout.audio_layers
        return (torch.arange(chunks)[:, None] * self.ids_per_chunk + within).flatten()

    def build(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        target: Int[Tensor, "b n p q"],
        missing: Int[Tensor, " b"],
    ) -> Sequences:
        """See `SequenceOrder.build`. A band needs no short windows: `missing` chunks only lose their loss."""
        sound = self.layout.audio_ids(audio).view(len(audio), -1, self.audio_per_chunk)
        moves = self.layout.motion_ids(context).view(len(audio), -1, self.motion_per_chunk)
        body = torch.cat([sound, moves], dim=2).flatten(1)
        start = torch.full_like(body[:, :1], self.layout.start_id)
        chunks = sound.shape[1]
        motion = torch.arange(self.motion_per_chunk, device=body.device) + self.audio_per_chunk
        at = (torch.arange(chunks, device=body.device)[:, None] * self.ids_per_chunk + motion).flatten()
        predictors = at.view(-1, self.layout.segments).T.contiguous()
        mask = self._present(missing, chunks, MOTION_TOKENS_PER_CHUNK)
        return Sequences(torch.cat([start, body[:, :-1]], 1), None, predictors, self._targets(target), mask)


class Prefix(SequenceOrder):
    """The paper's order: all audio of the window, then all its motion; the window slides under every position."""

    @property
    def lookback(self) -> None:
        """Within a window everything earlier is seen."""
        return None

    def heard(self, chunks: int) -> Int[Tensor, " f"]:
        """See `SequenceOrder.heard`."""
        frames = torch.arange(chunks * AUDIO_FRAMES_PER_CHUNK) + 1
        return len(self.layout.before_audio) - 1 + frames * self.layout.audio_layers

    def prompt(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        missing: Int[Tensor, " b"],
        example: Int[Tensor, "b m"] | None = None,
    ) -> tuple[Int[Tensor, "b t"], Bool[Tensor, "b t"]]:
        """Ids and validity of audio followed by as much motion as `context` holds.

        `example` are the ids that a system prompt shows in front, -1 where a row has fewer (paper, Exemplar-Driven
        Control); rows without any have no system prompt.
        """
        rows, device = audio.shape[0], audio.device
        sound, moves = self.layout.audio_ids(audio), self.layout.motion_ids(context)
        before, between = (
            torch.tensor(ids, dtype=torch.int64, device=device).expand(rows, -1)
            for ids in (self.layout.before_audio, self.layout.before_motion)
        )
        chunks = sound.shape[1] // self.audio_per_chunk
        there = self._present(missing, chunks, self.audio_per_chunk)
        moved = self._present(missing, chunks, self.motion_per_chunk)[:, : moves.shape[1]]
        yes, also = torch.ones_like(before, dtype=torch.bool), torch.ones_like(between, dtype=torch.bool)
        ids, valid = [before, sound, between, moves], [yes, there, also, moved]
        if example is not None:
            shown, is_shown = self._shown(example)
            ids, valid = [shown, *ids], [is_shown, *valid]
        return torch.cat(ids, dim=1), torch.cat(valid, dim=1)

    def _shown(self, example: Int[Tensor, "b m"]) -> tuple[Int[Tensor, "b t"], Bool[Tensor, "b t"]]:
        """The system prompt of each row; it is invalid in rows without an example."""
        rows, is_id = len(example), example >= 0
        head, tail = (
            torch.tensor(ids, dtype=torch.int64, device=example.device).expand(rows, -1)
            for ids in (self.layout.before_example, self.layout.after_example)
        )
        any_ = is_id.any(1, keepdim=True)
        valid = torch.cat([any_.expand(-1, head.shape[1]), is_id, any_.expand(-1, tail.shape[1])], dim=1)
        return torch.cat([head, example.clamp(min=0), tail], dim=1), valid

    def build(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        target: Int[Tensor, "b n p q"],
        missing: Int[Tensor, " b"],
        example: Int[Tensor, "b m"] | None = None,
    ) -> Sequences:
        """See `SequenceOrder.build`. `example`: see `prompt`."""
        ids, valid = self.prompt(audio, context, missing, example)
        count = context.shape[1] * self.layout.segments
        first = ids.shape[1] - count - 1
        at = torch.arange(first, first + count, device=ids.device)
        predictors = at.view(-1, self.layout.segments).T.contiguous()
        mask = self._present(missing, context.shape[1] // MOTION_TOKENS_PER_CHUNK, MOTION_TOKENS_PER_CHUNK)
        return Sequences(ids[:, :-1], valid[:, :-1], predictors, self._targets(target), mask)


class Depth(SequenceOrder):
    """Per motion time step (a frame) its 20 audio ids and its 3 Q motion ids; a position of the backbone is a frame.

    Each frame hears its own sound and the motion before it. Hidden states are one per code, frame after frame.
    """

    @property
    def audio_per_frame(self) -> int:
        """Audio ids of a frame: 20."""
        return exact_div(self.audio_per_chunk, MOTION_TOKENS_PER_CHUNK)

    @property
    def lookback(self) -> int:
        """Frames that a position of the backbone sees, its own included."""
        return self.window_chunks * MOTION_TOKENS_PER_CHUNK

    def heard(self, chunks: int) -> Int[Tensor, " f"]:
        """Of each audio frame the position of the backbone that hears it."""
        frames = torch.arange(chunks * MOTION_TOKENS_PER_CHUNK)
        return frames.repeat_interleave(exact_div(AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK))

    def build(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        target: Int[Tensor, "b n p q"],
        missing: Int[Tensor, " b"],
    ) -> Sequences:
        """See `SequenceOrder.build`. `missing` chunks only lose their loss; `predictors` count hidden states."""
        sound = self.layout.audio_ids(audio).view(len(audio), -1, self.audio_per_frame)
        moves = self.layout.motion_ids(context).view(len(audio), -1, self.layout.segments)
        frames = sound.shape[1]
        at = torch.arange(frames * self.layout.segments, device=audio.device)
        predictors = at.view(frames, self.layout.segments).T.contiguous()
        mask = self._present(missing, exact_div(frames, MOTION_TOKENS_PER_CHUNK), MOTION_TOKENS_PER_CHUNK)
        return Sequences(torch.cat([sound, moves], dim=2).flatten(1), None, predictors, self._targets(target), mask)


def sequence_order(name: str, layout: TokenLayout, window_chunks: int) -> SequenceOrder:
    """The order of that name: `interleaved`, `prefix` or `depth`."""
    orders: dict[str, type[Interleaved | Prefix | Depth]] = {
        "interleaved": Interleaved,
        "prefix": Prefix,
        "depth": Depth,
    }
    return orders[name](layout, window_chunks)
