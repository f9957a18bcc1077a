"""The generator: a Qwen2 transformer over audio and motion ids, with the output head cut to one segment at a time.

Paper, Settings: Qwen2.5-0.5B-Instruct with its tied embeddings detached. The state-dict names are those of
transformers' `Qwen2ForCausalLM`, so that its weights initialise the body (`initial.init_from_qwen`). Departure:
only the K rows of the position's segment are ever computed, in training, scoring and sampling alike; the paper's
full softmax gives mass to codes that the cyclic grammar forbids.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.nn import Checkpointed
from echoavatar.nn.rotary import phase_table, rotary, rotary_phases

from ..tokens import Sequences
from .attention import banded_attention, masked_attention
from .config import GeneratorConfig
from .depth_model import DepthReader
from .exemplar import Exemplar, ExemplarControl, member_rows, raise_logits, spread_hints


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
        self._initialise()

    def _initialise(self) -> None:
        """Normal with 0.02; what writes into the residual path shrinks with depth."""
        for name, parameter in self.named_parameters():
            if name.endswith("bias"):
                nn.init.zeros_(parameter)
            elif parameter.dim() > 1:
                into_residual = name.endswith(("o_proj.weight", "down_proj.weight"))
                nn.init.normal_(parameter, std=0.02 / ((2 * self.config.layers) ** 0.5 if into_residual else 1))
        if self.depth is not None:
            self.depth.balance()
        if self.exemplar is not None:
            self.exemplar.clear()

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

    def read(self, batch: Sequences, exemplar: Exemplar | None = None) -> Float[Tensor, "b t c"]:
        """Hidden states of training sequences, under a directive where one is given."""
        if exemplar is None or self.exemplar is None:
            return self.forward(batch.ids, batch.valid, asked=batch.asked)
        rows = member_rows(self.model.embed_tokens.weight, self.config.layout)
        hint = self.exemplar.hint(exemplar.members, rows)
        if self.depth is not None:
            return self.forward(batch.ids, hints=exemplar.holds[..., None] * hint[:, None], asked=batch.asked)
        return self.forward(batch.ids, batch.valid, spread_hints(hint, exemplar, batch))

    def code_logits(
        self, batch: Sequences, hidden: Float[Tensor, "b t c"], exemplar: Exemplar | None = None
    ) -> Float[Tensor, "k b n K"]:
        """Logits of every motion code asked for, under a directive where one is given."""
        logits = self.segment_logits(hidden, batch.predictors)
        if exemplar is None or self.exemplar is None:
            return logits
        return raise_logits(self.exemplar, logits, hidden, exemplar.at(batch.asked), batch)

    def tables(self) -> list[nn.Embedding]:
        """The embedding tables of its transformers."""
        bodies = [self.model] if self.depth is None else [self.model, self.depth.body]
        return [body.embed_tokens for body in bodies]

    def matrices(self) -> list[nn.Parameter]:
        """The matrices inside the layers of its transformers."""
        bodies = [self.model] if self.depth is None else [self.model, self.depth.body]
        return [p for body in bodies for p in body.layers.parameters() if p.dim() == 2]

    def segment_head(self) -> Float[Tensor, "k K c"]:
        """The motion rows of the output head by segment, a view."""
        layout = self.config.layout
        rows = self.lm_head.weight[layout.motion_base :][: layout.segments * layout.motion_codes]
        return rows.view(layout.segments, layout.motion_codes, -1)

    def segment_logits(
        self, hidden: Float[Tensor, "b t c"], predictors: Int[Tensor, "k n"]
    ) -> Float[Tensor, "k b n K"]:
        """For each segment its K logits at the positions that predict it: one grouped product."""
        rows = hidden.shape[0]
        chosen = hidden[:, predictors].transpose(0, 1).flatten(1, 2)
        logits = torch.bmm(chosen, self.segment_head().transpose(1, 2))
        return logits.view(len(logits), rows, -1, self.config.layout.motion_codes)
