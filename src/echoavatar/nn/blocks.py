"""Pre-norm transformer block over causal look-back attention, and its MLP (paper, Motion Tokenizer)."""

import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from .attention import AttentionState, CausalAttention
from .stream import StreamingModule


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
