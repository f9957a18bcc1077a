"""The learned effect of a manner on the generator; see `manner` for what it is told."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.models.generator.manner import HANDS, HEIGHTS, KNOTS, MANNER


class MannerControl(nn.Module):
    """Learned effect of the numbers `TOLD`: piecewise linear functions of each, summed over the numbers."""

    def __init__(self, width: int, read_width: int, codes: int) -> None:
        super().__init__()
        self.proj = nn.Linear(len(MANNER + HANDS) * KNOTS, width, bias=False)
        self.codes_proj = nn.Linear(len(HEIGHTS) * KNOTS, codes, bias=False)
        self.gate_proj = nn.Linear(read_width, 1)
        self.clear()

    def clear(self) -> None:
        """Reset to no effect."""
        for parameter in self.parameters():
            nn.init.zeros_(parameter)
        nn.init.ones_(self.gate_proj.bias)

    def hint(self, told: Float[Tensor, "*b m"]) -> Float[Tensor, "*b c"]:
        """The vector to add to the input; a number that is NaN is not told and adds nothing."""
        hint: Tensor = self.proj(_near(told[..., : -len(HEIGHTS)]))
        return hint

    def likely(self, told: Float[Tensor, "*b m"]) -> Float[Tensor, "*b K"]:
        """What to add to the logits of the upper body's first-layer codes, times the `gate`; for NaN as `hint`."""
        logits: Tensor = self.codes_proj(_near(told[..., -len(HEIGHTS) :]))
        return logits

    def gate(self, hidden: Float[Tensor, "*b c"]) -> Float[Tensor, "*b 1"]:
        """By how much: little in a dance, whose arms follow the music."""
        gate: Tensor = self.gate_proj(hidden)
        return gate


def _near(told: Float[Tensor, "*b m"]) -> Float[Tensor, "*b n"]:
    """How near each number is to each knot, between 0 and 1; 0 for NaN."""
    knots = torch.linspace(0, 1, KNOTS, device=told.device)
    return (1 - (told[..., None] - knots).abs() * (KNOTS - 1)).clamp(min=0).nan_to_num(0).flatten(-2)
