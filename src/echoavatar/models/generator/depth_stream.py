"""Streaming in the depth order: for each motion frame one step of the backbone, then its codes one by one.

The backbone keeps a ring of keys and values, one slot a frame. The depth transformer forgets each frame when it is
drawn. Both are `Decoder`s, so that a CPU runs the compiled loop and all precisions hold. To the compiled loop of the
depth transformer, the backbone's hidden state is a hint: it is added to the embedding of every code.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.nn.graphs import GraphCache
from echoavatar.nn.stream import StreamState, write_rows

from .config import AUDIO_FRAMES_PER_TOKEN, GeneratorConfig
from .decoder import Decodable, Decoder, KeyValueRing, Places
from .exemplar import ExemplarControl, Steer, member_rows
from .linear import Precision
from .model import Body, Generator
from .sampling import Sampler
from .stream import GeneratorStream


@dataclass(frozen=True)
class Part:
    """One of the two transformers, as `Decoder` takes it."""

    config: GeneratorConfig
    model: Body
    heads: Float[Tensor, "k K c"]
    exemplar: ExemplarControl | None = None

    def segment_head(self) -> Float[Tensor, "k K c"]:
        """See `Decodable`."""
        return self.heads


class DepthDecoder(Decoder):
    """The frozen depth transformer, and the backbone before it.

    The backbone's one head is the map into the depth transformer. What each audio code adds to the backbone's input is
    looked up, because the map of a frame's ten embeddings would read as many weights as a layer has.
    """

    def __init__(self, generator: Decodable, precision: Precision) -> None:
        assert isinstance(generator, Generator)
        assert generator.depth is not None
        config, depth = generator.config, generator.depth
        super().__init__(Part(config.depth, depth.body, generator.segment_head(), generator.exemplar), precision)
        self._backbone = Decoder(Part(config, generator.model, depth.condition.weight[None]), precision)
        self._table = generator.model.embed_tokens.weight.detach().float()
        layout, by_place = config.layout, depth.sound.weight.detach().float().view(config.width, -1, config.width)
        sounds = self._table[layout.audio_base :][: layout.audio_layers * layout.audio_codes]
        self._sounds = torch.einsum("opi,ai->pao", by_place, sounds)
        for part in (self, self._backbone):
            part.keep_compiled()
        self._frames = GraphCache[Sequence[KeyValueRing]](self._frame, lambda rings: [*_tensors(rings)])

    @property
    def backbone(self) -> Decoder:
        """The frozen backbone."""
        return self._backbone

    def steer(self, exemplar: Float[Tensor, "b K"] | None, bias: Float[Tensor, "b K"] | None) -> Steer | None:
        """See `Decoder.steer`; the hint is the backbone's."""
        exemplar = None if self._control is None else exemplar
        given = bias if exemplar is None else exemplar
        if given is None:
            return None
        if exemplar is None or self._control is None:
            return Steer(given.new_zeros(len(given), self._table.shape[1]), torch.zeros_like(given), given)
        hint = self._control.hint(exemplar, member_rows(self._table, self.config.layout))
        return Steer(hint, exemplar, torch.zeros_like(exemplar) if bias is None else bias)

    def embed(
        self, sound: Int[Tensor, "b i"], last: Int[Tensor, "b k"], is_first: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b c"]:
        """The backbone's input from a frame's audio ids and the motion ids of the frame before, if there was one."""
        layout = self.config.layout
        place = torch.arange(AUDIO_FRAMES_PER_TOKEN, device=sound.device).repeat_interleave(layout.audio_layers)
        heard = self._sounds[place, sound - layout.audio_base].sum(1)
        start = self._table[layout.start_id]
        return heard + torch.where(is_first[:, None], start, self._table[last].sum(1))

    def frame(
        self,
        sound: Int[Tensor, "b i"],
        last: Int[Tensor, "b k"],
        is_first: Bool[Tensor, " b"],
        places: Places,
        rings: Sequence[KeyValueRing],
        sampler: Sampler,
        steer: Steer | None,
    ) -> Int[Tensor, "b k"]:
        """The codes of one frame, a captured graph on CUDA. `places` are the backbone's."""
        return self._frames(rings, None, sound, last, is_first, *places, *sampler, *(steer or ()))

    def _frame(
        self, rings: Sequence[KeyValueRing], _: None, sound: Tensor, last: Tensor, is_first: Tensor, *inputs: Tensor
    ) -> Int[Tensor, "b k"]:
        places, sampler = Places(*inputs[:3]), Sampler(*inputs[3:6])
        steer = Steer(*inputs[6:]) if len(inputs) > 6 else None
        x = self.embed(sound, last, is_first)
        hidden = self._backbone.read(x if steer is None else x + steer.hint, places, rings)
        condition = self._backbone.logits(hidden, 0)
        rows, count = last.shape
        own, slots = self._own_places(rows, count), self.rings(rows, count)
        first = self.read(condition, own.part(0, 1), slots)
        nothing = condition.new_zeros(rows, len(self._directed) * self.config.layout.motion_codes)
        members, bias = (nothing, nothing) if steer is None else steer[1:]
        return self.draw(first, own.part(1), slots, sampler, Steer(condition, members, bias))

    def _own_places(self, rows: int, count: int) -> Places:
        """Positions of the depth transformer: each sees those before it in the frame, and never the spare slot."""
        at = torch.arange(count + 1, device=self.device)
        positions, seen = at[:-1].expand(rows, -1), at[:-1, None] >= at
        everyone = torch.ones(rows, dtype=torch.bool, device=self.device)
        return self.places(positions, positions, seen.expand(rows, -1, -1), everyone)


def _tensors(rings: Sequence[KeyValueRing]) -> list[Tensor]:
    return [tensor for ring in rings for tensor in ring.tensors()]


@dataclass
class FrameState(StreamState):
    """Keys and values of the backbone's window, the last frame's codes, and how many frames were heard."""

    rings: list[KeyValueRing]
    last: Int[Tensor, "b p q"]
    frames: Int[Tensor, " b"]


class DepthStream(GeneratorStream[FrameState]):
    """Bounded memory, no re-reading: a chunk costs two steps of the backbone and 6 Q of the depth transformer."""

    _decoder_type: ClassVar[type[Decoder]] = DepthDecoder
    _decoder: DepthDecoder

    def __init__(self, generator: Generator, precision: Precision = "float32") -> None:
        super().__init__(generator, precision)
        self._slots = generator.config.window_tokens

    def init_state(self, rows: int) -> FrameState:
        """A fresh state."""
        device, layout = self._decoder.device, self.layout
        last = torch.zeros(rows, layout.parts, layout.motion_layers, dtype=torch.int64, device=device)
        return FrameState(self._decoder.backbone.rings(rows, self._slots), last, last[:, 0, 0].clone())

    def _heard(self, state: FrameState) -> Int[Tensor, " b"]:
        return state.frames // self.config.step

    def _generate(
        self,
        x: Int[Tensor, "b f l"],
        state: FrameState,
        active: Bool[Tensor, " b"],
        sampler: Sampler,
        steer: Steer | None,
    ) -> Int[Tensor, "b n p q"]:
        noise, count, frames = sampler.noise, self.layout.segments, []
        for at, sound in enumerate(torch.split(x, AUDIO_FRAMES_PER_TOKEN, dim=1)):
            drawn = self._decoder.frame(
                *self._inputs(sound, state),
                self._places(state, active),
                state.rings,
                sampler._replace(noise=noise[:, at * count : (at + 1) * count]),
                steer,
            )
            frames.append(self.layout.unflatten(drawn))
            self._advance(state, frames[-1][:, 0], active)
        return torch.cat(frames, dim=1)

    @torch.no_grad()
    def prime(
        self, x: Int[Tensor, "b f l"], motion: Int[Tensor, "b n p q"], state: FrameState, active: Bool[Tensor, " b"]
    ) -> None:
        """See `GeneratorStream.prime`."""
        for at, sound in enumerate(torch.split(x, AUDIO_FRAMES_PER_TOKEN, dim=1)):
            embedded = self._decoder.embed(*self._inputs(sound, state))
            self._decoder.backbone.read(embedded, self._places(state, active), state.rings)
            self._advance(state, motion[:, at].long(), active)

    def _inputs(self, sound: Int[Tensor, "b f l"], state: FrameState) -> tuple[Tensor, Tensor, Tensor]:
        """Audio ids, the last frame's motion ids, and which rows have none."""
        return self.layout.audio_ids(sound), self.layout.motion_ids(state.last[:, None]), state.frames == 0

    def _advance(self, state: FrameState, codes: Int[Tensor, "b p q"], active: Bool[Tensor, " b"]) -> None:
        for tensor in _tensors(state.rings):
            tensor[..., -1] = 0
        write_rows(state.last, codes, active)
        write_rows(state.frames, state.frames + 1, active)

    def _places(self, state: FrameState, active: Bool[Tensor, " b"]) -> Places:
        """The frame's position, its slot, and the slots of the window; the oldest frame makes room for the new one."""
        at = state.frames[:, None]
        slots = at % self._slots
        age = (slots[..., None] - torch.arange(self._slots + 1, device=at.device)) % self._slots
        seen = age <= at[..., None]
        seen[..., -1] = False
        return self._decoder.backbone.places(at, slots, seen, active)
