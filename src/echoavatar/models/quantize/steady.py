"""Steady codes: the cheapest sequence of codes for a clip when every change of code has a price.

Near the border of two codes a vector flips from one to the other and back. The flips hardly change the decoded motion,
but a generator has to predict each of them, and they hide the changes that matter. So the motion that a generator
learns from is encoded as video is, by distortion plus rate (Potts model, solved exactly by dynamic programming). Not in
the paper. It matters in training only: a live session encodes no motion.
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
