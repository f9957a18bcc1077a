"""Drawing codes: temperature, nucleus, and noise that depends on the session's seed and the absolute position alone.

So the same session gives the same motion in one big push, in many small ones, and beside any neighbour.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

_GOLDEN = -7046029254386353131  # 0x9E3779B97F4A7C15 as a signed number
_FIRST = -4658895280553007687  # 0xBF58476D1CE4E5B9
_SECOND = -7723592293110705685  # 0x94D049BB133111EB


def mix(x: Int[Tensor, "..."]) -> Int[Tensor, "..."]:
    """SplitMix64's finaliser on 64-bit integers, wrapping; every output bit depends on every input bit."""
    x = (x ^ _shift(x, 30)) * _FIRST
    x = (x ^ _shift(x, 27)) * _SECOND
    return x ^ _shift(x, 31)


def _shift(x: Int[Tensor, "..."], bits: int) -> Int[Tensor, "..."]:
    """Logical right shift."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)


def uniform_noise(
    seeds: Int[Tensor, " b"], start: Int[Tensor, " b"], *, count: int, codes: int
) -> Float[Tensor, "b n K"]:
    """Uniform numbers in (0, 1), double precision, for positions `start` .. `start` + `count` - 1 of each row."""
    position = start[:, None] + torch.arange(count, device=seeds.device)
    counter = position[..., None] * codes + torch.arange(codes, device=seeds.device)
    word = mix(mix(seeds + _GOLDEN)[:, None, None] + (counter + 1) * _GOLDEN)
    return (_shift(word, 11).double() + 0.5) * 2.0**-53


def gumbel_noise(
    seeds: Int[Tensor, " b"], start: Int[Tensor, " b"], *, count: int, codes: int
) -> Float[Tensor, "b n K"]:
    """Gumbel noise: the code with the largest logit + noise is a draw from the softmax of the logits."""
    return (-torch.log(-torch.log(uniform_noise(seeds, start, count=count, codes=codes)))).float()


def nucleus(logits: Float[Tensor, "b K"], top_p: Float[Tensor, " b"]) -> Float[Tensor, "b K"]:
    """Drop the unlikely codes: keep the fewest whose mass reaches `top_p` (the likeliest always)."""
    ordered = logits.sort(dim=1, descending=True).values
    mass = torch.softmax(ordered, dim=1)
    kept = (mass.cumsum(dim=1) - mass < top_p[:, None]).sum(dim=1, keepdim=True).clamp(min=1)
    return logits.masked_fill(logits < ordered.gather(1, kept - 1), -torch.inf)


class Sampler(NamedTuple):
    """Draws the codes of one step, with the noise for all of its positions."""

    noise: Float[Tensor, "b n K"]
    sharpness: Float[Tensor, "b q"]  # factor of the logits, by layer of the RVQ
    top_p: Float[Tensor, " b"]

    def draw(self, logits: Float[Tensor, "b K"], position: int) -> Int[Tensor, " b"]:
        """The codes at one position of the step."""
        logits = logits * self.sharpness[:, position % self.sharpness.shape[1], None]
        return (nucleus(logits, self.top_p) + self.noise[:, position]).argmax(dim=1)


def make_sampler(
    noise: Float[Tensor, "b n K"],
    temperature: Float[Tensor, " b"],
    top_p: Float[Tensor, " b"],
    *,
    layers: int = 1,
    cooling: float = 1.0,
) -> Sampler:
    """A sampler with temperature and nucleus per row; temperature 0 takes the likeliest code.

    Layer q of a part is drawn at temperature x `cooling`^q: the coarse layers choose what happens, and what the fine
    ones add is detail, which noise turns into trembling.
    """
    warm = temperature > 0
    warmth = cooling ** -torch.arange(layers, device=noise.device)
    sharpness = torch.where(warm, 1 / temperature.clamp(min=1e-6), 1.0)[:, None] * warmth
    return Sampler(noise * warm[:, None, None], sharpness, top_p)
