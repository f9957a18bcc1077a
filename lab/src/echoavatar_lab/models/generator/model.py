"""The generator: a Qwen2 transformer over audio and motion ids, with the output head cut to one segment at a time.

Paper, Settings: Qwen2.5-0.5B-Instruct with its tied embeddings detached. The state-dict names are those of
transformers' `Qwen2ForCausalLM`, so that its weights initialise the body. Departure: only the K rows of the position's
segment are ever computed, in training, scoring and sampling alike; the paper's full softmax gives mass to codes that
the cyclic grammar forbids. Attention in a sliding band is computed in blocks of queries, so that keys outside the band
cost nothing.

The depth order (`DepthReader`) is not in the paper, which flattens all ids into one sequence; it follows RQ-Transformer
and Moshi. The backbone runs at 7.5 Hz: its input is the sound of the frame (the layers of each audio frame summed, the
ten audio frames mapped together) and the last motion frame (the sum of its code embeddings). The depth transformer then
predicts the frame's 3 Q codes in the order of the segments. Each of its positions gets the backbone's hidden state and
the code before. So the large transformer runs once for 3 Q codes and 20 audio ids, where the flattened one runs
3 Q + 20 times.
"""

from contextlib import AbstractContextManager, nullcontext

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel

from echoavatar.models.generator.config import AUDIO_FRAMES_PER_TOKEN, GeneratorConfig
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.models.generator.exemplar import ExemplarControl
from echoavatar_lab.models.generator.manner_control import MannerControl
from echoavatar_lab.nn.attention import phase_table, rotary, rotary_phases

BLOCK = 256


def in_band(query: Int[Tensor, " t"], key: Int[Tensor, " s"], lookback: int | None) -> Bool[Tensor, "t s"]:
    """Which key positions a query position sees: itself and the `lookback` - 1 before it."""
    gap = query[:, None] - key[None, :]
    return gap >= 0 if lookback is None else (gap >= 0) & (gap < lookback)


def banded_attention(
    q: Float[Tensor, "b h t d"], k: Float[Tensor, "b h t d"], v: Float[Tensor, "b h t d"], lookback: int | None
) -> Float[Tensor, "b h t d"]:
    """Each position attends to itself and the `lookback` - 1 positions before it."""
    length = q.shape[2]
    if length <= BLOCK and (lookback is None or lookback >= length):
        with _kernel(q):
            return F.scaled_dot_product_attention(q, k, v, is_causal=True)
    at = torch.arange(length, device=q.device)
    parts = []
    for start in range(0, length, BLOCK):
        stop = min(start + BLOCK, length)
        first = 0 if lookback is None else max(0, start - lookback + 1)
        mask = in_band(at[start:stop], at[first:stop], lookback)
        with _kernel(q):
            block = F.scaled_dot_product_attention(
                q[:, :, start:stop], k[:, :, first:stop], v[:, :, first:stop], attn_mask=mask
            )
        parts.append(block)
    return torch.cat(parts, dim=2)


def masked_attention(
    q: Float[Tensor, "b h t d"],
    k: Float[Tensor, "b h t d"],
    v: Float[Tensor, "b h t d"],
    lookback: int | None,
    valid: Bool[Tensor, "b t"],
) -> Float[Tensor, "b h t d"]:
    """The same with invalid positions; an invalid position sees itself alone."""
    at = torch.arange(q.shape[2], device=q.device)
    mask = in_band(at, at, lookback) & valid[:, None, :] | torch.eye(len(at), dtype=torch.bool, device=q.device)
    return F.scaled_dot_product_attention(q, k, v, attn_mask=mask[:, None])


def _kernel(q: Tensor) -> AbstractContextManager[None]:
    """On a CPU the fused kernel's backward pass in bfloat16 takes seven times as long as the plain one."""
    is_trained = q.requires_grad and q.device.type == "cpu"
    return sdpa_kernel(SDPBackend.MATH) if is_trained else nullcontext()


class RMSNorm(nn.Module):
    """x / rms(x) times a learned scale, in float32 at least."""

    def __init__(self, width: int, eps: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(width))
        self.eps = eps

    def forward(self, x: Float[Tensor, "... c"]) -> Float[Tensor, "... c"]:
        """Normalise the last axis."""
        return F.rms_norm(x.to(self.weight.dtype), self.weight.shape, self.weight, self.eps)


class SelfAttention(nn.Module):
    """Grouped-query attention with biased q, k, v and rotary positions."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        self.heads, self.kv_heads, self.head_width = config.heads, config.kv_heads, config.head_width
        self.q_proj = nn.Linear(config.width, config.width)
        self.k_proj = nn.Linear(config.width, config.kv_heads * config.head_width)
        self.v_proj = nn.Linear(config.width, config.kv_heads * config.head_width)
        self.o_proj = nn.Linear(config.width, config.width, bias=False)

    def forward(
        self,
        x: Float[Tensor, "b t c"],
        table: Float[Tensor, "2 #b 1 t d"],
        lookback: int | None,
        valid: Bool[Tensor, "b t"] | None,
    ) -> Float[Tensor, "b t c"]:
        """Attend to what `lookback` and `valid` allow."""
        split = (x.shape[0], x.shape[1], -1, self.head_width)
        q, k, v = (proj(x).view(split).transpose(1, 2) for proj in (self.q_proj, self.k_proj, self.v_proj))
        q, k = rotary(q, table).to(v.dtype), rotary(k, table).to(v.dtype)
        group = self.heads // self.kv_heads
        k, v = k.repeat_interleave(group, dim=1), v.repeat_interleave(group, dim=1)
        y = banded_attention(q, k, v, lookback) if valid is None else masked_attention(q, k, v, lookback, valid)
        mixed: Tensor = self.o_proj(y.transpose(1, 2).flatten(2))
        return mixed


class GatedMLP(nn.Module):
    """SwiGLU."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        self.gate_proj = nn.Linear(config.width, config.mlp, bias=False)
        self.up_proj = nn.Linear(config.width, config.mlp, bias=False)
        self.down_proj = nn.Linear(config.mlp, config.width, bias=False)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """Position by position."""
        y: Tensor = self.down_proj(F.silu(self.gate_proj(x)) * self.up_proj(x))
        return y


class DecoderLayer(nn.Module):
    """Attention and MLP, each behind a norm and beside a residual path."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        self.self_attn = SelfAttention(config)
        self.mlp = GatedMLP(config)
        self.input_layernorm = RMSNorm(config.width, config.norm_eps)
        self.post_attention_layernorm = RMSNorm(config.width, config.norm_eps)

    def forward(
        self,
        x: Float[Tensor, "b t c"],
        table: Float[Tensor, "2 #b 1 t d"],
        lookback: int | None,
        valid: Bool[Tensor, "b t"] | None,
    ) -> Float[Tensor, "b t c"]:
        """One layer."""
        x = x + self.self_attn(self.input_layernorm(x), table, lookback, valid)
        y: Tensor = x + self.mlp(self.post_attention_layernorm(x))
        return y


class Body(nn.Module):
    """Embedding, layers, final norm: transformers' `Qwen2Model`."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        self.config = config
        self.embed_tokens = nn.Embedding(config.layout.vocabulary, config.width)
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.layers))
        self.norm = RMSNorm(config.width, config.norm_eps)

    def forward(
        self,
        x: Float[Tensor, "b t c"],
        positions: Int[Tensor, "#b t"],
        lookback: int | None,
        valid: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t c"]:
        """Layers and final norm over what was embedded."""
        phases = rotary_phases(positions, width=self.config.head_width, base=self.config.rope_theta)
        table = phase_table(phases)[:, :, None].to(torch.promote_types(self.norm.weight.dtype, torch.float32))
        for layer in self.layers:
            x = layer(x, table, lookback, valid)
        hidden: Tensor = self.norm(x)
        return hidden


class DepthReader(nn.Module):
    """The parts of a depth-order generator besides its backbone and its heads."""

    def __init__(self, config: GeneratorConfig, body: Body) -> None:
        """`body` is the transformer over codes, with an embedding table of its own."""
        super().__init__()
        self.config, self.body = config, body
        self.sound = nn.Linear(AUDIO_FRAMES_PER_TOKEN * config.width, config.width, bias=False)
        self.condition = nn.Linear(config.width, config.depth_width, bias=False)

    def forward(
        self,
        backbone: Body,
        ids: Int[Tensor, "b t"],
        hints: Float[Tensor, "b n c"] | None,
        asked: Int[Tensor, " f"] | None = None,
    ) -> Float[Tensor, "b m d"]:
        """The hidden state that predicts each code, frame after frame; see `tokens.Depth` for the ids.

        With `asked`, of these frames alone: the backbone reads all.
        """
        sizes = self.sizes
        sound, moves = torch.split(ids.view(len(ids), -1, sum(sizes)), sizes, dim=2)
        x = self.heard(backbone, sound) + self.moved(backbone, moves)
        x = x if hints is None else x + hints
        hidden = self.run(backbone, x)
        return self.codes(hidden, moves) if asked is None else self.codes(hidden[:, asked], moves[:, asked])

    @property
    def sizes(self) -> list[int]:
        """Audio ids and motion ids of a frame."""
        layout = self.config.layout
        return [AUDIO_FRAMES_PER_TOKEN * layout.audio_layers, layout.segments]

    def run(self, backbone: Body, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """The backbone's hidden state of each frame."""
        frames = torch.arange(x.shape[1], device=x.device)[None]
        hidden: Tensor = backbone(x, frames, self.config.order.lookback)
        return hidden

    def heard(self, backbone: Body, sound: Int[Tensor, "b n i"]) -> Float[Tensor, "b n c"]:
        """The backbone's input from the audio ids of each frame."""
        by_layer = backbone.embed_tokens(sound).unflatten(2, (AUDIO_FRAMES_PER_TOKEN, -1))
        heard: Tensor = self.sound(by_layer.sum(3).flatten(2))
        return heard

    def moved(self, backbone: Body, moves: Int[Tensor, "b n k"]) -> Float[Tensor, "b n c"]:
        """The backbone's input from the motion ids of the frame before; the start id stands before the first."""
        start: Tensor = backbone.embed_tokens(torch.full_like(moves[:, :1, 0], self.config.layout.start_id))
        return torch.cat([start, backbone.embed_tokens(moves[:, :-1]).sum(2)], dim=1)

    def codes(self, hidden: Float[Tensor, "b n c"], ids: Int[Tensor, "b n k"]) -> Float[Tensor, "b m d"]:
        """The hidden state that predicts each id of each frame, from the backbone's and the ids before in the frame."""
        rows, _, count = ids.shape
        before = F.pad(self.body.embed_tokens(ids[..., :-1]), (0, 0, 1, 0))
        x = (before + self.condition(hidden)[:, :, None]).flatten(0, 1)
        places = torch.arange(count, device=ids.device)[None]
        read: Tensor = self.body(x, places, None)
        return read.view(rows, -1, read.shape[2])


def _control(config: GeneratorConfig) -> ExemplarControl | None:
    """Weights of control by exemplars; control tokens in the prompt need none."""
    has_weights = config.exemplar and config.control == "gate"
    return ExemplarControl(config.width, config.read_width) if has_weights else None


class Generator(Checkpointed):
    """Ids in, hidden states and segment logits out."""

    config_type = GeneratorConfig
    config: GeneratorConfig

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        self.config = config
        self.model = Body(config)
        self.depth = DepthReader(config, Body(config.depth)) if config.sequence == "depth" else None
        self.lm_head = nn.Linear(config.read_width, config.layout.vocabulary, bias=False)
        self.exemplar = _control(config)
        self.manner = (
            MannerControl(config.width, config.read_width, config.layout.motion_codes) if config.manner else None
        )

    def forward(
        self,
        ids: Int[Tensor, "b t"],
        valid: Bool[Tensor, "b t"] | None = None,
        hints: Float[Tensor, "b n c"] | None = None,
        asked: Int[Tensor, " f"] | None = None,
    ) -> Float[Tensor, "b m d"]:
        """Hidden states after the final norm. Positions count the valid ids; invalid ones are never attended to.

        `hints` are added to the embeddings of the ids. In the depth order there is a hidden state for each motion code
        (of the frames `asked`), and a hint for each frame.
        """
        if self.depth is not None:
            return self.depth(self.model, ids, hints, asked)  # type: ignore[no-any-return]
        if valid is None:
            positions = torch.arange(ids.shape[1], device=ids.device)[None]
        else:
            positions = (valid.long().cumsum(1) - 1).clamp(min=0)
        x = self.model.embed_tokens(ids)
        x = x if hints is None else x + hints
        hidden: Tensor = self.model(x, positions, self.config.order.lookback, valid)
        return hidden

    def segment_head(self) -> Float[Tensor, "k K c"]:
        """The motion rows of the output head by segment, a view."""
        layout = self.config.layout
        rows = self.lm_head.weight[layout.motion_base :][: layout.segments * layout.motion_codes]
        return rows.view(layout.segments, layout.motion_codes, -1)
