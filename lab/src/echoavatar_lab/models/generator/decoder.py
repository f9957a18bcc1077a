"""The generator rearranged for decoding: fused projections, folded norms, keys and values in preallocated rings.

A prompt is read in one pass (`run`); then codes are drawn one by one (`draw`), on a CPU by the compiled loop. On CUDA
both together (`generate`) are one captured graph. Computes what `Generator.forward` computes, with few operations per
token: norm scales are folded into the next projection, q, k and v are one product, gate and up are one product, and
rotary positions are one complex product, for which the channels of each q and k head are reordered into pairs.

In the depth order (`DepthDecoder`) both transformers are `Decoder`s, so that a CPU runs the compiled loop and all
precisions hold. The depth transformer forgets each frame when it is drawn. To its compiled loop, the backbone's hidden
state is a hint: it is added to the embedding of every code.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from echoavatar.models.generator import compiled
from echoavatar.models.generator.config import AUDIO_FRAMES_PER_TOKEN, Precision
from echoavatar.models.generator.frames import KeyValueRing
from echoavatar.models.generator.frozen import stacked
from echoavatar.nn.kernel_math import Matrices
from echoavatar_lab.models.generator.exemplar import ExemplarControl, Steer, member_rows
from echoavatar_lab.models.generator.linear import FloatLinear, FrozenLayer, FrozenLinear, frozen_linear
from echoavatar_lab.models.generator.manner_control import MannerControl
from echoavatar_lab.models.generator.model import Body, DecoderLayer, Generator
from echoavatar_lab.models.generator.sampling import Sampler
from echoavatar_lab.nn.attention import rotary_phases
from echoavatar_lab.nn.graphs import GraphCache


class Places(NamedTuple):
    """The positions of one step: their rotary phases, the slots they are written to, and which slots they see."""

    rotations: Complex[Tensor, "b t 1 half"]  # of length 1
    slots: Int[Tensor, "b t"]
    bias: Float[Tensor, "b 1 1 t s"]  # 0 where a slot is seen, -inf where not

    def part(self, start: int, stop: int | None = None) -> "Places":
        """The positions from `start` to `stop` of the step."""
        rotations, slots, bias = self
        return Places(rotations[:, start:stop], slots[:, start:stop], bias[:, :, :, start:stop])


class Decoder:
    """Frozen weights of a transformer of a generator and of its heads, on their device."""

    def __init__(
        self,
        body: Body,
        heads: Float[Tensor, "k K c"],
        precision: Precision,
        *,
        control: ExemplarControl | None = None,
        manner: MannerControl | None = None,
    ) -> None:
        config = self.config = body.config
        width = config.width
        self._embedding = body.embed_tokens.weight.detach().float()
        self._layers = [
            FrozenLayer(layer, config.head_width, precision) for layer in body.layers if isinstance(layer, DecoderLayer)
        ]
        scale = body.norm.weight.detach().float() * width**0.5
        self._heads = [frozen_linear(precision, segment * scale) for segment in heads.detach()]
        self._control = control
        self._manner = manner
        self._gates = torch.zeros(2, width, device=self.device), torch.zeros(2, device=self.device)
        for row, each in enumerate((control, manner)):
            if each is not None:
                self._gates[0][row] = each.gate_proj.weight.detach()[0].float() * scale
                self._gates[1][row] = each.gate_proj.bias.detach()[0].float()
        self._directed = config.directed
        self._hinted = self._embedding  # whose rows make the hint of a set
        self._root_eps = torch.full((1, 1), (width * config.norm_eps) ** 0.5, device=self.device)
        self._compiled = self._compile() if self.device.type == "cpu" and precision != "bfloat16" else None
        self._graphs = GraphCache[Sequence[KeyValueRing]](self._generate, _tensors)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self._embedding.device

    def rings(self, rows: int, slots: int) -> list[KeyValueRing]:
        """Empty rings of `slots` positions and a spare slot, which takes the writes of rows that must not change."""
        config = self.config
        shape = (rows, config.kv_heads, config.head_width, slots + 1)
        return [
            KeyValueRing(torch.zeros(shape, device=self.device), torch.zeros(shape, device=self.device))
            for _ in range(config.layers)
        ]

    def places(
        self,
        positions: Int[Tensor, "b t"],
        slots: Int[Tensor, "b t"],
        seen: Bool[Tensor, "b t s"],
        active: Bool[Tensor, " b"],
    ) -> Places:
        """Places of a step's positions; rows that are not active write to the spare slot."""
        config, spare = self.config, seen.shape[2] - 1
        phases = rotary_phases(positions, width=config.head_width, base=config.rope_theta)
        rotations = torch.polar(torch.ones_like(phases), phases).to(torch.complex64)
        slots = torch.where(active[:, None], slots, spare)
        bias = torch.zeros(seen.shape, device=positions.device).masked_fill_(~seen, -torch.inf)
        return Places(rotations[:, :, None], slots, bias[:, None, None])

    def steer(
        self,
        exemplar: Float[Tensor, "b K"] | None,
        bias: Float[Tensor, "b K"] | None,
        manner: Float[Tensor, "b m"] | None = None,
    ) -> Steer | None:
        """The effect of a set of codes, of a bias on their logits, and of a manner.

        Without exemplar control the set has no effect, except on a prompt that shows it; so has a manner on a generator
        that was told none.
        """
        if self._control is None and not self.config.layout.before_example:
            exemplar = None
        if self._manner is None:
            manner = None
        given = next((each for each in (exemplar, bias, manner) if each is not None), None)
        if given is None:
            return None
        codes = len(self._directed) * self.config.layout.motion_codes
        hint, raised = given.new_zeros(len(given), self._hinted.shape[1]), given.new_zeros(len(given), 2, codes)
        if exemplar is not None:
            raised[:, 0] = exemplar
        if exemplar is not None and self._control is not None:
            hint = self._control.hint(exemplar, member_rows(self._hinted, self.config.layout))
        if manner is not None and self._manner is not None:
            hint, raised[:, 1] = hint + self._manner.hint(manner), self._manner.likely(manner)
        return Steer(hint, raised, torch.zeros_like(raised[:, 0]) if bias is None else bias)

    def generate(
        self,
        prompt: Int[Tensor, "b t"],
        places: Places,
        rings: Sequence[KeyValueRing],
        sampler: Sampler,
        steer: Steer | None,
        *,
        hinted: int = 1,
        captured: bool = True,
    ) -> Int[Tensor, "b n"]:
        """Read the prompt, then draw one code for each position of the sampler; the last code is not read back.

        `places` are those of the prompt and of all codes. Without rings, keys and values are kept for this call only.
        The last `hinted` ids of the prompt predict motion codes. A prompt whose length is rare should not be
        `captured` as a CUDA graph, which costs several times what a plain call does.
        """
        run = self._graphs if captured else self._generate
        return run(rings, hinted, prompt, *places, *sampler, *(steer or ()))

    def _generate(
        self, rings: Sequence[KeyValueRing], hinted: int, prompt: Tensor, *inputs: Tensor
    ) -> Int[Tensor, "b n"]:
        """See `generate`, whose arguments come as plain tensors."""
        places, sampler = Places(*inputs[:3]), Sampler(*inputs[3:6])
        steer = Steer(*inputs[6:]) if len(inputs) > 6 else None
        (rows, length), slots = prompt.shape, places.bias.shape[4] - 1
        rings, hint = rings or self.rings(rows, slots), None if steer is None else steer.hint
        hidden = self.run(prompt, places.part(0, length), rings, hint, hinted)
        return self.draw(hidden, places.part(length), rings, sampler, steer)

    def run(
        self,
        ids: Int[Tensor, "b t"],
        places: Places,
        rings: Sequence[KeyValueRing],
        hint: Float[Tensor, "b c"] | None = None,
        hinted: int = 1,
    ) -> Float[Tensor, "b c"]:
        """Read ids, write their keys and values, return the normed hidden state of the last position.

        `hint` is added to the embeddings of the last `hinted` ids.
        """
        rows, length = ids.shape
        x = self._embedding[ids.flatten()]
        if hint is not None:
            x.view(rows, length, -1)[:, -hinted:] += hint[:, None]
        return self.read(x, places, rings)

    def read(self, x: Float[Tensor, "n c"], places: Places, rings: Sequence[KeyValueRing]) -> Float[Tensor, "b c"]:
        """`run` for inputs that are embedded already, row by row; a single position takes the compiled loop."""
        rows, length = places.slots.shape
        if self._compiled is not None and length == 1:
            hidden = compiled.read_position(self._compiled, x.numpy(), *_arrays(rings), _positions(places))
            return torch.from_numpy(hidden)
        for layer, ring in zip(self._layers, rings, strict=True):
            qkv = layer.qkv(self._norm(x, layer.dtype)).float()
            x = x + layer.out(self._attend(qkv, places, ring).to(layer.dtype))
            gate, up = layer.gate_up(self._norm(x, layer.dtype)).chunk(2, dim=1)
            x = x + layer.down((F.silu(gate) * up).to(layer.dtype))
        last = x if length == 1 else x.view(rows, length, -1)[:, -1]
        return self._norm(last, self._heads[0].dtype)

    def logits(self, hidden: Float[Tensor, "b c"], segment: int, steer: Steer | None = None) -> Float[Tensor, "b K"]:
        """The K logits of one segment, under a directive where one is given."""
        logits = self._heads[segment](hidden).float()
        if steer is None or segment not in self._directed:
            return logits
        at = self._directed.index(segment) * logits.shape[1]
        part = slice(at, at + logits.shape[1])
        gates = F.linear(hidden.float(), *self._gates)
        return logits + (gates[..., None] * steer.raised[..., part]).sum(1) + steer.bias[:, part]

    def draw(
        self,
        hidden: Float[Tensor, "b c"],
        places: Places,
        rings: Sequence[KeyValueRing],
        sampler: Sampler,
        steer: Steer | None,
    ) -> Int[Tensor, "b n"]:
        """The codes of a chunk, from the hidden state that predicts the first; the last one is not read back.

        `places` are those of the codes.
        """
        if self._compiled is not None:
            unused = np.zeros(len(hidden), np.uint64)  # the noise is known
            noise, starts = sampler.noise.numpy(), unused.astype(np.int64)
            draws = compiled.Draws(noise, unused, starts, sampler.sharpness.numpy(), sampler.top_p.numpy())
            steering, at = self._steering(steer, len(hidden)), _positions(places)
            drawn = compiled.draw_codes(self._compiled, hidden.numpy(), *_arrays(rings), at, draws, steering)
            return torch.from_numpy(drawn)
        layout, hint = self.config.layout, None if steer is None else steer.hint
        codes, count = [], sampler.noise.shape[1]
        for index in range(count):
            segment = index % layout.segments
            codes.append(sampler.draw(self.logits(hidden, segment, steer), index))
            if index < count - 1:
                ids = codes[-1][:, None] + layout.segment_start(segment)
                hidden = self.run(ids, places.part(index, index + 1), rings, hint)
        return torch.stack(codes, dim=1)

    def _compile(self) -> compiled.Weights:
        """The weights in the layout of the compiled loop."""
        config, layers = self.config, self._layers
        assert all(isinstance(head, FloatLinear) for head in self._heads)

        def joined(*maps: FrozenLinear) -> Matrices:
            return stacked([one.stored() for one in maps if isinstance(one, FloatLinear)])

        starts = [config.layout.segment_start(segment) for segment in range(config.layout.segments)]
        return compiled.Weights(
            stacked([(self._embedding.numpy(), None)]),
            joined(*(layer.qkv for layer in layers)),
            joined(*(layer.out for layer in layers)),
            joined(*(layer.gate_up for layer in layers)),
            joined(*(layer.down for layer in layers)),
            joined(*self._heads),
            np.array(starts),
            np.float32(config.width * config.norm_eps),
        )

    def _steering(self, steer: Steer | None, rows: int) -> compiled.Steering:
        width, codes = self.config.width, self.config.layout.motion_codes
        directed = np.array(self._directed)
        gates, gate_biases = (part.numpy() for part in self._gates)
        if steer is None:
            hint = np.zeros((rows, width), np.float32)
            raised = np.zeros((rows, 2, codes * len(directed)), np.float32)
            return compiled.Steering(directed - len(self._heads), hint, raised, raised[:, 0].copy(), gates, gate_biases)
        hint, raised, bias = (np.ascontiguousarray(part.numpy()) for part in steer)
        return compiled.Steering(directed, hint, raised, bias, gates, gate_biases)

    def _norm(self, x: Float[Tensor, "n c"], dtype: torch.dtype) -> Float[Tensor, "n c"]:
        """Bring to unit length, x / sqrt(|x|^2 + c eps); the missing sqrt(c) is folded into the weights."""
        length = torch.linalg.vector_norm(x, dim=1, keepdim=True)
        return (x / torch.hypot(length, self._root_eps)).to(dtype)

    def _attend(self, qkv: Float[Tensor, "n qkv"], places: Places, ring: KeyValueRing) -> Float[Tensor, "n c"]:
        heads, kv, width = self.config.heads, self.config.kv_heads, self.config.head_width
        (rows, length), group, slots = places.slots.shape, heads // kv, ring.keys.shape[3]
        split = qkv.view(rows, length, heads + 2 * kv, width)
        pairs = torch.view_as_complex(split.view(rows, length, -1, width // 2, 2))
        rotated = torch.view_as_real(pairs[:, :, : heads + kv] * places.rotations).flatten(3)
        where = places.slots[:, None, None].expand(rows, kv, width, length)
        ring.keys.scatter_(3, where, rotated[:, :, heads:].permute(0, 2, 3, 1))
        ring.values.scatter_(3, where, split[:, :, heads + kv :].permute(0, 2, 3, 1))
        q = rotated[:, :, :heads].reshape(rows, length, kv, group, width).permute(0, 2, 3, 1, 4)
        q = q.reshape(rows * kv, group * length, width)
        scores = torch.bmm(q, ring.keys.view(rows * kv, width, slots))
        weights = torch.softmax(scores.view(rows, kv, group, length, slots).add_(places.bias), dim=-1)
        values = ring.values.view(rows * kv, width, slots).transpose(1, 2)
        y = torch.bmm(weights.view(rows * kv, group * length, slots), values)
        return y.view(rows, heads, length, width).transpose(1, 2).reshape(rows * length, heads * width)


class DepthDecoder(Decoder):
    """The frozen depth transformer, and the backbone before it.

    The backbone's one head is the map into the depth transformer. What each audio code adds to the backbone's input is
    looked up, because the map of a frame's ten embeddings would read as many weights as a layer has.
    """

    def __init__(self, generator: Generator, precision: Precision) -> None:
        assert generator.depth is not None
        config, depth = generator.config, generator.depth
        heads = generator.segment_head()
        super().__init__(depth.body, heads, precision, control=generator.exemplar, manner=generator.manner)
        self.backbone = Decoder(generator.model, depth.condition.weight[None], precision)
        self._table = self._hinted = generator.model.embed_tokens.weight.detach().float()
        layout, by_place = config.layout, depth.sound.weight.detach().float().view(config.width, -1, config.width)
        sounds = self._table[layout.audio_base :][: layout.audio_layers * layout.audio_codes]
        self._sounds = torch.einsum("opi,ai->pao", by_place, sounds)
        for part in (self, self.backbone):
            if part._compiled is not None:  # it reads every position, so the layers that read prompts are not needed
                part._layers.clear()
        self._frames = GraphCache[Sequence[KeyValueRing]](self._frame, _tensors)
        self._own = dict[tuple[int, int], Places]()

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
        hidden = self.backbone.read(x if steer is None else x + steer.hint, places, rings)
        condition = self.backbone.logits(hidden, 0)
        rows, count = last.shape
        own, slots = self._own_places(rows, count), self.rings(rows, count)
        first = self.read(condition, own.part(0, 1), slots)
        nothing = condition.new_zeros(rows, 2, len(self._directed) * self.config.layout.motion_codes)
        raised, bias = (nothing, nothing[:, 0]) if steer is None else steer[1:]
        return self.draw(first, own.part(1), slots, sampler, Steer(condition, raised, bias))

    def _own_places(self, rows: int, count: int) -> Places:
        """Positions of the depth transformer: each sees those before it in the frame, and never the spare slot."""
        if (rows, count) not in self._own:
            at = torch.arange(count + 1, device=self.device)
            positions, seen = at[:-1].expand(rows, -1), at[:-1, None] >= at
            everyone = torch.ones(rows, dtype=torch.bool, device=self.device)
            self._own[rows, count] = self.places(positions, positions, seen.expand(rows, -1, -1), everyone)
        return self._own[rows, count]


def _arrays(rings: Sequence[KeyValueRing]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return [ring.keys.numpy() for ring in rings], [ring.values.numpy() for ring in rings]


def _positions(places: Places) -> compiled.Positions:
    return compiled.Positions(places.rotations[:, :, 0].numpy(), places.slots.numpy(), places.bias[:, 0, 0].numpy())


def _tensors(rings: Sequence[KeyValueRing]) -> list[Tensor]:
    return [tensor for ring in rings for tensor in ring.arrays()]
