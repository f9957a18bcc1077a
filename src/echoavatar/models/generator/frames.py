"""The generator of the depth order on a CPU: a chunk of audio codes in, its motion codes out, without torch.

For each motion token (here: a frame) the backbone reads one position: its sound and the last frame's codes. Then the
depth transformer draws the frame's 3 Q codes one after another; the backbone's hidden state is added to what it reads.
Both run in the compiled loop. Memory is bounded: the state holds keys and values of the window.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.nn import StreamState
from echoavatar.nn.kernel_math import F, Matrices, product
from echoavatar.stored import Stored, check_shapes

from ..noise import GOLDEN, mix
from .compiled import Draws, Positions, Steering, draw_codes, read_position
from .config import AUDIO_FRAMES_PER_TOKEN, GeneratorConfig
from .frozen import Frozen, rows_of, shapes
from .manner import HEIGHTS, near_knots


@dataclass
class KeyValueRing(StreamState):
    """Keys (already rotated) and values of one layer, slots last, so that sums over slots run through memory."""

    keys: Float[Any, "b h d s"]
    values: Float[Any, "b h d s"]


@dataclass
class FrameState(StreamState):
    """Keys and values of the backbone's window, the last frame's codes, and how many frames were heard."""

    rings: list[KeyValueRing]
    last: Int[Any, "b p q"]
    frames: Int[Any, " b"]


class FrameStream:
    """Frozen weights of both transformers."""

    def __init__(self, config: GeneratorConfig, arrays: Mapping[str, Stored], *, rounds: bool = True) -> None:
        """`arrays` are the checkpoint's; with `rounds` weights are int8, else float32.

        Raises CheckpointError: names or shapes of arrays do not fit the config.
        """
        check_shapes(shapes(config), {name: stored.shape for name, stored in arrays.items()}, origin="the generator")
        self.config, layout = config, config.layout
        frozen, self._table = Frozen(arrays, rounds=rounds), arrays["model.embed_tokens.weight"]
        motion = slice(layout.motion_base, layout.motion_base + layout.segments * layout.motion_codes)
        heads = rows_of(arrays["lm_head.weight"], motion).reshape(layout.segments, layout.motion_codes, -1)
        self._backbone = frozen.body("model", config, [frozen.floats("depth.condition.weight")])
        self._depth = frozen.body("depth.body", config.depth, heads)._replace(
            embedding=frozen.plain("depth.body.embed_tokens.weight", motion),
            starts=np.arange(layout.segments) * layout.motion_codes,
        )
        self._sound = frozen.plain("depth.sound.weight")
        self._starts = layout.motion_base + np.arange(layout.segments) * layout.motion_codes
        gates = np.zeros((2, config.read_width), F), np.zeros(2, F)
        after = frozen.floats("depth.body.norm.weight") * config.read_width**0.5
        for row, name in enumerate(("exemplar", "manner")):
            if f"{name}.gate_proj.weight" in frozen:
                gates[0][row] = frozen.floats(f"{name}.gate_proj.weight")[0] * after
                gates[1][row] = frozen.floats(f"{name}.gate_proj.bias")[0]
        self._gates = gates
        warmth = F(config.cooling) ** -np.arange(layout.motion_layers, dtype=F)
        self._sharpness = warmth / F(config.temperature or 1.0)
        self._within = functools.lru_cache(maxsize=16)(self._in_a_frame)
        self._maps = {
            name: frozen.plain(f"{name}.weight")
            for name in ("exemplar.hint_proj", "manner.proj", "manner.codes_proj")
            if f"{name}.weight" in frozen
        }

    def init_state(self, rows: int) -> FrameState:
        """A fresh state."""
        config, layout = self.config, self.config.layout
        rings = [_ring(rows, config, config.window_tokens) for _ in range(config.layers)]
        return FrameState(
            rings, np.zeros((rows, layout.parts, layout.motion_layers), np.int64), np.zeros(rows, np.int64)
        )

    def step(
        self,
        x: Int[np.ndarray, "b f l"],
        state: FrameState,
        active: Bool[np.ndarray, " b"],
        *,
        seeds: Int[np.ndarray, " b"] | None = None,
        exemplar: Float[np.ndarray, "b K"] | None = None,
        bias: Float[np.ndarray, "b K"] | None = None,
        manner: Float[np.ndarray, "b m"] | None = None,
    ) -> Int[np.ndarray, "b n p q"]:
        """The motion codes for the audio codes of whole steps; see the lab's `GeneratorStream.step`.

        Rows that are not active return zeros.
        """
        layout, chosen = self.config.layout, np.flatnonzero(active)
        tokens = x.shape[1] // AUDIO_FRAMES_PER_TOKEN
        codes = np.zeros((len(x), tokens, layout.parts, layout.motion_layers), np.int64)
        if not len(chosen):
            return codes
        is_whole = len(chosen) == len(x)
        own = state if is_whole else state.mapped(lambda part: part[chosen])
        hint, raised, added = (part[chosen] for part in self._steer(len(x), exemplar, bias, manner))
        keys = np.zeros(len(x), np.int64) if seeds is None else seeds
        for at in range(tokens):
            sound = x[chosen, at * AUDIO_FRAMES_PER_TOKEN : (at + 1) * AUDIO_FRAMES_PER_TOKEN]
            codes[chosen, at] = self._frame(sound, own, keys[chosen], hint, raised, added)
        if not is_whole:
            for whole, part in zip(state.arrays(), own.arrays(), strict=True):
                whole[chosen] = part
        return codes

    def _frame(
        self,
        sound: Int[np.ndarray, "b f l"],
        state: FrameState,
        seeds: Int[np.ndarray, " b"],
        hint: Float[np.ndarray, "b c"],
        raised: Float[np.ndarray, "b 2 K"],
        bias: Float[np.ndarray, "b K"],
    ) -> Int[np.ndarray, "b p q"]:
        """The codes of the next frame; `state` moves on."""
        config, rows, layout = self.config, len(sound), self.config.layout
        slot = state.frames % config.window_tokens
        age = (slot[:, None] - np.arange(config.window_tokens)) % config.window_tokens
        at = _positions(state.frames[:, None], slot[:, None], (age <= state.frames[:, None])[:, None], config)
        x = self._heard(sound) + self._moved(state) + hint
        hidden = read_position(self._backbone, x, *_parts(state.rings), at)
        condition = _mapped(self._backbone.heads, hidden)

        own = _parts([_ring(rows, config.depth, layout.segments) for _ in range(config.depth.layers)])
        within, later = self._within(rows)
        first = read_position(self._depth, condition, *own, within)
        steering = Steering(np.array(config.directed), condition, raised, bias, *self._gates)
        drawn = draw_codes(self._depth, first, *own, later, self._draws(seeds, state.frames), steering)
        state.last[:] = drawn.reshape(state.last.shape)
        state.frames += 1
        codes: np.ndarray = state.last
        return codes

    def _in_a_frame(self, rows: int) -> tuple[Positions, Positions]:
        """The positions of a frame's codes, each of which sees those before it: of all, and of all but the first."""
        count = self.config.layout.segments
        places = np.tile(np.arange(count), (rows, 1))  # a copy: for read-only arrays the loop would be compiled anew
        seen = np.broadcast_to(np.tri(count, dtype=bool), (rows, count, count))
        within = Positions(*map(np.ascontiguousarray, _positions(places, places, seen, self.config.depth)))
        return within, Positions(*(np.ascontiguousarray(part[:, 1:]) for part in within))

    def _draws(self, seeds: Int[np.ndarray, " b"], frames: Int[np.ndarray, " b"]) -> Draws:
        """Noise, temperature and nucleus of a frame; see the lab's `sampling.make_sampler`."""
        config, layout, rows = self.config, self.config.layout, len(seeds)
        codes = 0 if config.temperature > 0 else layout.motion_codes  # 0: noise follows from the keys
        noise, keys = np.zeros((rows, layout.segments, codes), F), mix(seeds.astype(np.uint64) + GOLDEN)
        sharpness, top_p = np.tile(self._sharpness, (rows, 1)), np.full(rows, config.top_p, F)
        return Draws(noise, keys, frames * layout.segments, sharpness, top_p)

    def _heard(self, sound: Int[np.ndarray, "b f l"]) -> Float[np.ndarray, "b c"]:
        """The backbone's input from the audio codes of a frame: the layers of each audio frame summed, all mapped."""
        layout = self.config.layout
        ids = sound + layout.audio_base + np.arange(layout.audio_layers) * layout.audio_codes
        each = rows_of(self._table, ids).sum(2)
        return _mapped(self._sound, each.reshape(len(sound), -1))

    def _moved(self, state: FrameState) -> Float[np.ndarray, "b c"]:
        """The backbone's input from the codes of the frame before; the start id stands before the first."""
        ids = state.last.reshape(len(state.last), -1) + self._starts
        moved = rows_of(self._table, ids).sum(1)
        start = rows_of(self._table, [self.config.layout.start_id])
        return np.where(state.frames[:, None] == 0, start, moved)

    def _steer(
        self,
        rows: int,
        exemplar: Float[np.ndarray, "b K"] | None,
        bias: Float[np.ndarray, "b K"] | None,
        manner: Float[np.ndarray, "b m"] | None,
    ) -> tuple[Float[np.ndarray, "b c"], Float[np.ndarray, "b 2 K"], Float[np.ndarray, "b K"]]:
        """What a set of codes, a bias on their logits and a manner do; see the lab's `exemplar.Steer`."""
        config, layout = self.config, self.config.layout
        hint = np.zeros((rows, config.width), F)
        raised = np.zeros((rows, 2, len(config.directed) * layout.motion_codes), F)
        if exemplar is not None and "exemplar.hint_proj" in self._maps:
            raised[:, 0], first = exemplar, layout.segment_start(config.directed[0])
            for row, members in enumerate(exemplar):
                (members_of_row,) = np.nonzero(members)
                embedded = rows_of(self._table, first + members_of_row)
                total = (members[members_of_row, None] * embedded).sum(0) * max(len(members_of_row), 1) ** -0.5
                hint[row] = _mapped(self._maps["exemplar.hint_proj"], total[None].astype(F))[0]
        if manner is not None and "manner.proj" in self._maps:
            hint += _mapped(self._maps["manner.proj"], near_knots(manner[:, : -len(HEIGHTS)]))
            raised[:, 1] = _mapped(self._maps["manner.codes_proj"], near_knots(manner[:, -len(HEIGHTS) :]))
        return hint, raised, np.zeros_like(raised[:, 0]) if bias is None else bias


def _ring(rows: int, config: GeneratorConfig, slots: int) -> KeyValueRing:
    shape = (rows, config.kv_heads, config.head_width, slots)
    return KeyValueRing(np.zeros(shape, F), np.zeros(shape, F))


def _parts(rings: Sequence[KeyValueRing]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return [ring.keys for ring in rings], [ring.values for ring in rings]


def _positions(
    at: Int[np.ndarray, "b t"], slots: Int[np.ndarray, "b t"], seen: Bool[np.ndarray, "b t s"], config: GeneratorConfig
) -> Positions:
    """Rotary phases are computed in double precision, because a session may be long."""
    exponent = np.arange(0, config.head_width, 2) / config.head_width
    phases = at[..., None] * config.rope_theta**-exponent % (2 * np.pi)
    return Positions(np.exp(1j * phases).astype(np.complex64), slots, np.where(seen, F(0), F(-np.inf)))


def _mapped(matrices: Matrices, x: Float[np.ndarray, "b i"]) -> Float[np.ndarray, "b o"]:
    y = np.empty((len(x), matrices.weight.shape[1]), F)
    product(x, matrices, 0, y)
    return y
