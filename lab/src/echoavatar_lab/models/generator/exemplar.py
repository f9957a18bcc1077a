"""Exemplar-driven control: a set of first-layer upper-body codes asks the generator for a motion.

Paper, Exemplar-Driven Control (after MECo): the first RVQ layer carries the meaning, so the codes that a reference clip
uses there, without order, are the directive. Which part of the body the paper means it does not say: the upper body is
the release's.

Two forms. `prompt` is the paper's: the set stands as control tokens in a system prompt, in front of a window that is
re-read every step (`tokens.prefix_prompt`, `control_ids`); the transformer learns what they mean, no weight is added.
`gate` (ours) costs no context, works in every order and may change at every chunk border: while a set holds, one vector
(the set's embeddings summed over the root of its size, mapped) is added to the input of every position that predicts a
motion code, and where the first layer of the upper body is predicted, the set's logits are raised by a learned gate.
Both maps begin at zero, so a generator trained without exemplars goes on unchanged.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from echoavatar.models.tokens import UPPER, TokenLayout


class Steer(NamedTuple):
    """The effect of a directive during one step of a stream."""

    hint: Float[Tensor, "b c"]  # added to the input of the positions that predict motion codes
    # Added to the logits of the segments directed, K for each: the set's codes and what hands' heights say, both times
    # their gates; and a bias as it is.
    raised: Float[Tensor, "b 2 K"]
    bias: Float[Tensor, "b K"]


class ExemplarControl(nn.Module):
    """Learned effect of a set: `hint` enters the input, `gate` of the hidden state raises the set's logits."""

    def __init__(self, width: int, read_width: int) -> None:
        super().__init__()
        self.hint_proj = nn.Linear(width, width, bias=False)
        self.gate_proj = nn.Linear(read_width, 1)
        self.clear()

    def clear(self) -> None:
        """Reset to no effect."""
        for parameter in self.parameters():
            nn.init.zeros_(parameter)

    def hint(self, members: Float[Tensor, "b K"], embeddings: Float[Tensor, "K c"]) -> Float[Tensor, "b c"]:
        """The vector to add to the input; zero for an empty set."""
        size = (members != 0).sum(dim=1, keepdim=True).clamp(min=1)
        mapped: Tensor = self.hint_proj(members @ embeddings * size**-0.5)
        return mapped

    def gate(self, hidden: Float[Tensor, "... c"]) -> Float[Tensor, "... 1"]:
        """By how much the logits of the set are raised."""
        raised: Tensor = self.gate_proj(hidden)
        return raised


def control_ids(members: Float[Tensor, "b K"], ids: Int[Tensor, " K"]) -> Int[Tensor, "b m"]:
    """The control tokens of each row's set, ascending, -1 behind the last; `ids` are those of all codes."""
    is_in = members > 0
    order = is_in.int().argsort(dim=1, descending=True, stable=True)[:, : int(is_in.sum(1).max())]
    return torch.where(is_in.gather(1, order), ids[order], -1)


def segment_of(layout: TokenLayout) -> int:
    """The segment whose codes the set holds: the first layer of the upper body, or of the whole body."""
    return min(UPPER, layout.parts - 1) * layout.motion_layers


def member_rows(weight: Float[Tensor, "v c"], layout: TokenLayout) -> Float[Tensor, "K c"]:
    """The embeddings of the codes that a set may hold, a view."""
    start = layout.segment_start(segment_of(layout))
    return weight[start : start + layout.motion_codes]
