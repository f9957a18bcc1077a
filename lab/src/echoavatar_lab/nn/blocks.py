"""Transformer blocks over frames: pre-norm, over look-back attention (paper, Motion Tokenizer) or over a whole clip."""

import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar_lab.nn.attention import AttentionState, CausalAttention, rotary, rotary_table
from echoavatar_lab.nn.stream import StreamingModule


class Mlp(nn.Module):
    """Linear, GELU (erf), linear; frame by frame."""

    def __init__(self, *, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(inputs, hidden)
        self.fc2 = nn.Linear(hidden, outputs)

    def forward(self, x: Float[Tensor, "*b c"]) -> Float[Tensor, "*b d"]:
        """Apply to the last axis."""
        y: Tensor = self.fc2(F.gelu(self.fc1(x)))
        return y


class CausalBlock(StreamingModule[AttentionState]):
    """x + Attention(norm(x)), then x + MLP(norm(x)); no norm at the end."""

    def __init__(self, *, width: int, heads: int, lookback: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width)
        self.attn = CausalAttention(width=width, heads=heads, lookback=lookback)
        self.norm2 = nn.LayerNorm(width)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip at once."""
        return self._finish(x + self.attn(self.norm1(x)))

    def init_state(self, rows: int) -> AttentionState:
        """Nothing seen yet."""
        return self.attn.init_state(rows)

    def step(
        self, x: Float[Tensor, "b t c"], state: AttentionState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t c"]:
        """The next frames of running clips."""
        return self._finish(x + self.attn.step(self.norm1(x), state, active))

    def _finish(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.mlp(self.norm2(x))
        return y


class FullBlock(nn.Module):
    """x + Attention(norm(x)), then x + MLP(norm(x)); every frame sees every other (rotary positions)."""

    def __init__(self, *, width: int, heads: int) -> None:
        super().__init__()
        if width % (2 * heads):
            raise ValueError(f"width ({width}) must be a multiple of twice the heads ({heads})")
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.proj = nn.Linear(width, width)
        self.mlp = Mlp(inputs=width, hidden=4 * width, outputs=width)

    def forward(self, x: Float[Tensor, "b t c"]) -> Float[Tensor, "b t c"]:
        """The whole clip."""
        split = (x.shape[0], x.shape[1], 3, self.heads, -1)
        q, k, v = self.qkv(self.norm1(x)).view(split).permute(2, 0, 3, 1, 4)
        table = rotary_table(x.shape[1], q.shape[-1]).to(q)
        mixed = F.scaled_dot_product_attention(rotary(q, table), rotary(k, table), v)
        x = x + self.proj(mixed.transpose(1, 2).flatten(2))
        y: Tensor = x + self.mlp(self.norm2(x))
        return y
