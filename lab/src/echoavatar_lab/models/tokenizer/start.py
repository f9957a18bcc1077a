"""A head start for short training runs: the tokenizer begins as a principal component analysis of single frames.

Ours, not the paper's. Every residual branch starts at zero, the first layer at the principal axes of the (normalised)
features, the last at their transpose: before the first step the network already returns the mean of each
token's four frames, and training only has to add the motion inside a token.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.models.tokenizer import MotionTokenizer
from echoavatar.nn import CausalBlock, Mlp

SPARE_SCALE = 0.1  # channels that no axis needs start with a small share of their usual weights


@torch.no_grad()
def start_from_principal_axes(tokenizer: MotionTokenizer, normal: Float[Tensor, "n c"]) -> None:
    """Initialise `tokenizer` from normalised features of its part.

    Raises:
        ValueError: it has no short path between its levels, which the axes need.
    """
    if tokenizer.config.blocks != "attention" or tokenizer.config.resampling != "dual":
        raise ValueError("the principal start needs attention blocks and dual-path resampling; turn it off")
    frames = normal.double()
    centred = frames - frames.mean(0)
    _, axes = torch.linalg.eigh(centred.T @ centred / len(frames))  # ascending
    width = tokenizer.config.width
    kept = min(width, normal.shape[1])
    axes = axes.flip(1)[:, :kept].to(tokenizer.input_liner.weight)
    first, last = tokenizer.input_liner, tokenizer.output_liner
    for layer in (first, last):
        layer.weight.mul_(SPARE_SCALE)
        nn.init.zeros_(layer.bias)
    first.weight[:kept] = axes.T
    last.weight[:, :kept] = axes
    for module in tokenizer.modules():
        if isinstance(module, CausalBlock):
            _silence(module.attn.proj)
        elif isinstance(module, Mlp):
            _silence(module.fc2)


def _silence(layer: nn.Linear) -> None:
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
