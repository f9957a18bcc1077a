"""Noise of the flow head, from the session's seed and the absolute frame alone.

Departs from the release, which draws anew for every frame: between draws `hold` frames apart the noise moves smoothly
from one to the next at unit variance, so that the face trembles less. A hold of 1 draws every frame.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..generator.sampling import uniform_noise

_SALT = 0x666163652D6E6F69  # so that the noise differs from the motion generator's for the same seed


def normal_noise(
    seeds: Int[Tensor, " b"], start: Int[Tensor, " b"], *, count: int, channels: int
) -> Float[Tensor, "b n c"]:
    """Independent standard normal numbers (Box-Muller, double) for positions `start` .. `start` + `count` - 1."""
    pairs = uniform_noise(seeds ^ _SALT, start, count=count, codes=2 * channels)
    radius = torch.sqrt(-2 * torch.log(pairs[..., :channels]))
    return radius * torch.cos(2 * math.pi * pairs[..., channels:])


def face_noise(
    seeds: Int[Tensor, " b"], start: Int[Tensor, " b"], *, count: int, channels: int, hold: int
) -> Float[Tensor, "b n c"]:
    """Noise of the frames `start` .. `start` + `count` - 1 of each row."""
    if hold == 1:
        return normal_noise(seeds, start, count=count, channels=channels)
    frame = start[:, None] + torch.arange(count, device=start.device)
    first = start // hold
    draws = normal_noise(seeds, first, count=(count + hold - 1) // hold + 2, channels=channels)
    place = frame // hold - first[:, None]
    angle = (frame % hold)[..., None] * (math.pi / 2 / hold)
    take = place[..., None].expand(-1, -1, channels)
    return draws.gather(1, take) * angle.cos() + draws.gather(1, take + 1) * angle.sin()
