"""Streaming generation: each chunk of audio codes in, two time steps of motion codes out (or the config's number).

`InterleavedStream` keeps a ring of keys and values of constant size: a step reads the previous id and 40 audio ids
in one pass, then decodes 6 Q ids one by one. `DepthStream` keeps such a ring for the backbone, one slot a motion frame.
`PrefixStream` is the paper's sliding window: its state is the code history and every step reads the whole window again.
All three have one interface.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.models.generator.config import AUDIO_FRAMES_PER_TOKEN, Precision
from echoavatar.models.generator.frames import FrameState, KeyValueRing
from echoavatar.models.tokens import Interleaved, Prefix
from echoavatar.nn import StreamState
from echoavatar_lab.models.generator.decoder import Decoder, DepthDecoder, Places
from echoavatar_lab.models.generator.exemplar import Steer, control_ids
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sampling import Sampler, gumbel_noise, make_sampler
from echoavatar_lab.models.tokens import audio_ids, motion_ids, prefix_prompt, unflatten
from echoavatar_lab.nn.stream import StreamingModule, write_rows

StateT = TypeVar("StateT", bound=StreamState)


class GeneratorStream(StreamingModule[StateT]):
    """The common part of all sequence orders, built from a generator's present weights, on its device."""

    def __init__(self, generator: Generator, precision: Precision = "float32") -> None:
        super().__init__()
        self.config, self.layout = generator.config, generator.config.layout
        with torch.no_grad():
            self._decoder = self._frozen(generator, precision)

    def _frozen(self, generator: Generator, precision: Precision) -> Decoder:
        return Decoder(generator.model, generator.segment_head(), precision, control=generator.exemplar)

    @torch.no_grad()
    def step(
        self,
        x: Int[Tensor, "b f l"],
        state: StateT,
        active: Bool[Tensor, " b"],
        *,
        seeds: Int[Tensor, " b"] | None = None,
        temperature: Float[Tensor, " b"] | None = None,
        top_p: Float[Tensor, " b"] | None = None,
        exemplar: Float[Tensor, "b K"] | None = None,
        bias: Float[Tensor, "b K"] | None = None,
        manner: Float[Tensor, "b m"] | None = None,
    ) -> Int[Tensor, "b n p q"]:
        """Hear the audio codes of whole steps (b, 20 each, 2), return their motion codes (b, 2 each, 3, Q).

        `seeds` (default 0) key the noise of each row; `temperature` and `top_p` default to the config's. `exemplar` is
        each row's directive: the intensity of every code in its set of first-layer upper-body codes, 0 elsewhere (a
        generator trained without ignores it); `bias` is added to that layer's logits as it is. Where the config steers
        other segments both have K numbers for each of them. `manner` has the numbers of `Manner`, NaN where not told.
        """
        rows, device = x.shape[0], self._decoder.device
        seeds = torch.zeros(rows, dtype=torch.int64, device=device) if seeds is None else seeds
        if temperature is None:
            temperature = torch.full((rows,), self.config.temperature, device=device)
        top_p = torch.full((rows,), self.config.top_p, device=device) if top_p is None else top_p
        count, codes = self.config.step * self.layout.segments, self.layout.motion_codes
        steer = self._decoder.steer(exemplar, bias, manner)
        parts = []
        for chunk in torch.split(x, self.config.audio_frames, dim=1):
            noise = gumbel_noise(seeds, self._heard(state) * count, count=count, codes=codes)
            sampler = make_sampler(
                noise, temperature, top_p, layers=self.layout.motion_layers, cooling=self.config.cooling
            )
            parts.append(self._generate(chunk, state, active, sampler, steer))
        return torch.cat(parts, dim=1)

    @abstractmethod
    def prime(
        self, x: Int[Tensor, "b f l"], motion: Int[Tensor, "b n p q"], state: StateT, active: Bool[Tensor, " b"]
    ) -> None:
        """Take whole chunks of audio codes and their known motion as the past, for a prompt that begins with one."""

    def forward(self, x: Int[Tensor, "b f l"]) -> Int[Tensor, "b n p q"]:
        """A whole clip: one step from a fresh state, seed 0."""
        rows = x.shape[0]
        everyone = torch.ones(rows, dtype=torch.bool, device=self._decoder.device)
        return self.step(x, self.init_state(rows), everyone)

    @abstractmethod
    def _heard(self, state: StateT) -> Int[Tensor, " b"]:
        """Steps each row has heard."""

    @abstractmethod
    def _generate(
        self, x: Int[Tensor, "b f l"], state: StateT, active: Bool[Tensor, " b"], sampler: Sampler, steer: Steer | None
    ) -> Int[Tensor, "b n p q"]: ...


@dataclass
class RingState(StreamState):
    """Keys and values of the window, the id not yet read, and how many chunks were heard."""

    rings: list[KeyValueRing]
    last: Int[Tensor, " b"]  # id relative to the start id, so that zero is a fresh row
    chunks: Int[Tensor, " b"]


class InterleavedStream(GeneratorStream[RingState]):
    """Bounded memory, no re-reading: a step costs 41 ids in one pass and 6 Q - 1 single ones."""

    def __init__(self, generator: Generator, precision: Precision = "float32") -> None:
        super().__init__(generator, precision)
        assert isinstance(generator.config.order, Interleaved)
        self._order = generator.config.order
        self._slots = self._order.lookback + self._order.audio_per_chunk

    def init_state(self, rows: int) -> RingState:
        """A fresh state."""
        zero = torch.zeros(rows, dtype=torch.int64, device=self._decoder.device)
        return RingState(self._decoder.rings(rows, self._slots), zero, zero.clone())

    def _heard(self, state: RingState) -> Int[Tensor, " b"]:
        return state.chunks

    def _generate(
        self,
        x: Int[Tensor, "b f l"],
        state: RingState,
        active: Bool[Tensor, " b"],
        sampler: Sampler,
        steer: Steer | None,
    ) -> Int[Tensor, "b n p q"]:
        last = state.last[:, None] + self.layout.start_id
        prompt = torch.cat([last, audio_ids(self.layout, x)], dim=1)
        places = self._places(state, active)
        flat = self._decoder.generate(prompt, places, state.rings, sampler, steer)
        codes = unflatten(self.layout, flat)
        self._advance(state, motion_ids(self.layout, codes)[:, -1], active)
        return codes

    @torch.no_grad()
    def prime(
        self, x: Int[Tensor, "b f l"], motion: Int[Tensor, "b n p q"], state: RingState, active: Bool[Tensor, " b"]
    ) -> None:
        """See `GeneratorStream.prime`. Two passes a chunk, because the ring has no room to write it all at once."""
        sound, moves = (
            ids.view(len(ids), -1, each)
            for ids, each in (
                (audio_ids(self.layout, x), self._order.audio_per_chunk),
                (motion_ids(self.layout, motion), self._order.motion_per_chunk),
            )
        )
        for chunk in range(sound.shape[1]):
            last, places = state.last[:, None] + self.layout.start_id, self._places(state, active)
            heard = torch.cat([last, sound[:, chunk]], dim=1)
            self._decoder.run(heard, places.part(0, heard.shape[1]), state.rings)
            self._decoder.run(moves[:, chunk, :-1], places.part(heard.shape[1]), state.rings)
            self._advance(state, moves[:, chunk, -1], active)

    def _advance(self, state: RingState, last: Int[Tensor, " b"], active: Bool[Tensor, " b"]) -> None:
        _clear_spare(state.rings)
        write_rows(state.last, last - self.layout.start_id, active)
        write_rows(state.chunks, state.chunks + 1, active)

    def _places(self, state: RingState, active: Bool[Tensor, " b"]) -> Places:
        """Absolute positions of the chunk's ids, their slots, and which slots each one sees."""
        device, each = state.chunks.device, self._order.ids_per_chunk
        positions = state.chunks[:, None] * each + torch.arange(each, device=device)
        slots = positions % self._slots
        age = slots[..., None] - torch.arange(self._slots + 1, device=device)
        age = torch.where(age < 0, age + self._slots, age)  # of what the slot holds, seen from the position
        seen = (age < self._order.lookback) & (age <= positions[..., None])
        seen[..., -1] = False
        return self._decoder.places(positions, slots, seen, active)


@dataclass
class HistoryState(StreamState):
    """The codes of the window, newest last, and how many steps were heard."""

    audio: Int[Tensor, "b f l"]
    motion: Int[Tensor, "b n p q"]
    chunks: Int[Tensor, " b"]


class PrefixStream(GeneratorStream[HistoryState]):
    """The paper's window: every step reads up to 4 s of audio and the motion before the new step, then decodes.

    Where the config has an `opening`, it fills the part of the window that was not heard yet; else the window grows.
    """

    def __init__(self, generator: Generator, precision: Precision = "float32") -> None:
        super().__init__(generator, precision)
        assert isinstance(generator.config.order, Prefix)
        self._order = generator.config.order

    def init_state(self, rows: int) -> HistoryState:
        """A fresh state."""
        device, tokens, layout = self._decoder.device, self.config.window_tokens, self.layout

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(rows, *shape, dtype=torch.int64, device=device)

        audio = zeros(tokens * AUDIO_FRAMES_PER_TOKEN, layout.audio_layers)
        motion = zeros(tokens, layout.parts, layout.motion_layers)
        return HistoryState(audio, motion, zeros())

    def _heard(self, state: HistoryState) -> Int[Tensor, " b"]:
        return state.chunks

    def _generate(
        self,
        x: Int[Tensor, "b f l"],
        state: HistoryState,
        active: Bool[Tensor, " b"],
        sampler: Sampler,
        steer: Steer | None,
    ) -> Int[Tensor, "b n p q"]:
        audio = torch.cat([state.audio, x.long()], dim=1)[:, self.config.audio_frames :]
        context = state.motion[:, self.config.step :]
        example = self._example(steer)
        prompt, valid = self._prompt(audio, context, state.chunks, example)
        flat = self._decoder.generate(
            prompt,
            self._places(valid),
            [],
            sampler,
            steer,
            hinted=context[0].numel() + 1,  # the directive enters at the whole window, as in training
            captured=example is None,  # each example makes the prompt longer by its own size
        )
        codes = unflatten(self.layout, flat)
        write_rows(state.audio, audio, active)
        write_rows(state.motion, torch.cat([context, codes], dim=1), active)
        write_rows(state.chunks, state.chunks + 1, active)
        return codes

    @torch.no_grad()
    def prime(
        self, x: Int[Tensor, "b f l"], motion: Int[Tensor, "b n p q"], state: HistoryState, active: Bool[Tensor, " b"]
    ) -> None:
        """See `GeneratorStream.prime`."""
        for past, new in ((state.audio, x), (state.motion, motion)):
            write_rows(past, torch.cat([past, new.long()], dim=1)[:, new.shape[1] :], active)
        write_rows(state.chunks, state.chunks + x.shape[1] // self.config.audio_frames, active)

    def _prompt(
        self,
        audio: Int[Tensor, "b f l"],
        context: Int[Tensor, "b n p q"],
        heard: Int[Tensor, " b"],
        example: Int[Tensor, "b m"] | None,
    ) -> tuple[Int[Tensor, "b t"], Bool[Tensor, "b t"]]:
        """Ids of the window and which of them count."""
        config = self.config
        missing = (config.window_tokens // config.step - 1 - heard).clamp(min=0)
        if config.opening is None:
            return prefix_prompt(self._order, audio, context, missing, example)
        tokens, frames = (torch.arange(part.shape[1], device=audio.device) for part in (context, audio))
        is_before = tokens < (missing * config.step)[:, None]
        was_silent = frames < (missing * config.audio_frames)[:, None]
        silence = torch.tensor(config.opening.silence, device=audio.device)
        context = torch.where(is_before[..., None, None], config.opening.motion, context)
        audio = torch.where(was_silent[..., None], silence, audio)
        return prefix_prompt(self._order, audio, context, torch.zeros_like(missing), example)

    def _example(self, steer: Steer | None) -> Int[Tensor, "b m"] | None:
        """Ids of each row's set in the order of its codes, -1 behind the last; None where no prompt shows any."""
        members = None if steer is None else steer.raised[:, 0]
        if members is None or not self.layout.before_example or not bool((members > 0).any()):
            return None
        starts = torch.tensor([self.layout.segment_start(segment) for segment in self.config.directed])
        codes = torch.arange(self.layout.motion_codes)
        ids = (starts[:, None] + codes).flatten().to(members.device)
        return control_ids(members, ids)

    def _places(self, valid: Bool[Tensor, "b t"]) -> Places:
        rows, device = valid.shape[0], valid.device
        new = torch.ones(rows, self.config.step * self.layout.segments, dtype=torch.bool, device=device)
        valid = torch.cat([valid, new], dim=1)
        length = valid.shape[1]
        at = torch.arange(length, device=device)
        earlier = at[:, None] >= at
        seen = earlier & valid[:, None] | torch.eye(length, dtype=torch.bool, device=device)
        seen = torch.cat([seen, torch.zeros(rows, length, 1, dtype=torch.bool, device=device)], dim=2)
        positions = (valid.long().cumsum(1) - 1).clamp(min=0)
        everyone = torch.ones(rows, dtype=torch.bool, device=device)
        return self._decoder.places(positions, at.expand(rows, -1), seen, everyone)


class DepthStream(GeneratorStream[FrameState]):
    """Bounded memory, no re-reading: a chunk costs two steps of the backbone and 6 Q of the depth transformer."""

    _decoder: DepthDecoder

    def __init__(self, generator: Generator, precision: Precision = "float32") -> None:
        super().__init__(generator, precision)
        self._slots = generator.config.window_tokens

    def _frozen(self, generator: Generator, precision: Precision) -> DepthDecoder:
        return DepthDecoder(generator, precision)

    def init_state(self, rows: int) -> FrameState:
        """A fresh state."""
        device, layout = self._decoder.device, self.layout
        last = torch.zeros(rows, layout.parts, layout.motion_layers, dtype=torch.int64, device=device)
        return FrameState(self._decoder.backbone.rings(rows, self._slots), last, last[:, 0, 0].clone())

    def _heard(self, state: FrameState) -> Int[Tensor, " b"]:
        heard: Tensor = state.frames // self.config.step
        return heard

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
            frames.append(unflatten(self.layout, drawn))
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
        return audio_ids(self.layout, sound), motion_ids(self.layout, state.last[:, None]), state.frames == 0

    def _advance(self, state: FrameState, codes: Int[Tensor, "b p q"], active: Bool[Tensor, " b"]) -> None:
        _clear_spare(state.rings)
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


def _clear_spare(rings: Sequence[KeyValueRing]) -> None:
    """Forget what rows that were not active wrote."""
    for ring in rings:
        for tensor in ring.arrays():
            tensor[..., -1] = 0


def open_stream(
    generator: Generator, precision: Precision = "float32"
) -> InterleavedStream | PrefixStream | DepthStream:
    """The stream of this generator's sequence order."""
    kinds: dict[str, type[InterleavedStream | PrefixStream | DepthStream]] = {
        "interleaved": InterleavedStream,
        "prefix": PrefixStream,
        "depth": DepthStream,
    }
    return kinds[generator.config.sequence](generator, precision)
