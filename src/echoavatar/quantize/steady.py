"""Codes that change only where it is worth it: the cheapest way through a clip when every change of code has a price.

A vector near the border of two codes flips from one to the other and back at no gain to whoever decodes them, but a
generator has to foretell every flip: to it they are noise, and they drown the changes that mean something. So what a
generator learns from is encoded as video is, by distortion plus rate (Potts model, solved exactly by dynamic
programming). Not in the paper. Live, nothing is encoded, and decoding knows nothing of it.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def steadiest(distances: Float[Tensor, "n k"], price: Float[Tensor, ""] | float) -> Int[Tensor, " n"]:
    """The codes with the least sum of their distances and of `price` for every change; price 0 takes the nearest."""
    steps, codes = distances.shape
    same = torch.arange(codes, device=distances.device)
    came = same.repeat(steps, 1)  # at each step, the code before on the cheapest way to each code
    cost = distances[0].clone()
    for step in range(1, steps):
        cheapest, other = cost.min(0)
        stays = cost <= cheapest + price
        came[step] = torch.where(stays, same, other)
        cost = torch.where(stays, cost, cheapest + price) + distances[step]
    path = [int(cost.argmin())]
    for before in came[1:].flip(0):
        path.append(int(before[path[-1]]))
    return torch.tensor(path[::-1], device=distances.device)
