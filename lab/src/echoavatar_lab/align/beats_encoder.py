"""BEATs, the paper's audio encoder: a transformer over patches of filter banks, its weights named as published.

Chen et al., "BEATs: Audio Pre-Training with Acoustic Tokenizers". 128 filter banks every 10 ms (`fbank`) are cut into
patches of 16 x 16. Positions come from a wide grouped convolution and from a relative attention bias, which each query
scales by a gate. Layers are post-norm with DeepNorm's scaled residuals. A classifier head in the file is ignored.
"""

from collections.abc import Mapping
from typing import Self

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import CheckpointError

from .fbank import BANDS, fbank

PATCH = 16
GATES = 8  # values computed from a query for its two gates
SHARED_BIAS = "self_attn.relative_attention_bias.weight"  # one for all layers; stored once a layer


class BeatsConfig(Config):
    """Model sizes; the defaults are the published model's."""

    layers: int = Field(default=12, gt=0, description="transformer layers")
    width: int = Field(default=768, gt=0, description="channels")
    heads: int = Field(default=12, gt=0, description="attention heads")
    hidden: int = Field(default=3072, gt=0, description="channels inside the MLPs")
    patch_width: int = Field(default=512, gt=0, description="channels of a patch before projection")
    buckets: int = Field(default=320, gt=0, description="distances that the attention bias distinguishes")
    farthest: int = Field(default=800, gt=0, description="distance beyond which all share one bucket")
    reach: int = Field(default=128, gt=0, description="patches that the positional convolution spans")
    groups: int = Field(default=16, gt=0, description="groups of the positional convolution")


class PositionConv(nn.Module):
    """Positional convolution with weight normalisation: a magnitude for each tap times a direction."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.groups, self.reach = config.groups, config.reach
        shape = (config.width, config.width // config.groups, config.reach)
        self.weight_g = nn.Parameter(torch.ones(1, 1, config.reach))
        self.weight_v = nn.Parameter(torch.randn(shape) * (4 / (config.reach * config.width)) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(config.width))

    def forward(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """Keeps the length; an even kernel reaches one patch further back than ahead."""
        weight = self.weight_g * self.weight_v / self.weight_v.norm(dim=(0, 1), keepdim=True)
        y = F.conv1d(x.transpose(1, 2), weight, self.bias, padding=self.reach // 2, groups=self.groups)
        return F.gelu(y[..., : x.shape[1]]).transpose(1, 2)


class GatedAttention(nn.Module):
    """Attention with a relative position bias that each query gates."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        width, self.heads = config.width, config.heads
        self.q_proj, self.k_proj, self.v_proj, self.out_proj = (nn.Linear(width, width) for _ in range(4))
        self.grep_linear = nn.Linear(width // config.heads, GATES)
        self.grep_a = nn.Parameter(torch.ones(1, config.heads, 1, 1))

    def forward(self, x: Float[Tensor, "b n c"], bias: Float[Tensor, "h n n"]) -> Float[Tensor, "b n c"]:
        """Every patch attends to every patch."""
        q, k, v = (
            part(x).unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in (self.q_proj, self.k_proj, self.v_proj)
        )
        gates = self.grep_linear(q).unflatten(-1, (2, GATES // 2)).sum(-1).sigmoid()
        gate = gates[..., :1] * (gates[..., 1:] * self.grep_a - 1) + 2
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=gate * bias)
        y: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(2))
        return y


class BeatsLayer(nn.Module):
    """Post-norm attention and MLP; the residual branch is scaled by `residual`."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.residual = (2 * config.layers) ** 0.25
        self.self_attn = GatedAttention(config)
        self.self_attn_layer_norm, self.final_layer_norm = (nn.LayerNorm(config.width) for _ in range(2))
        self.fc1 = nn.Linear(config.width, config.hidden)
        self.fc2 = nn.Linear(config.hidden, config.width)

    def forward(self, x: Float[Tensor, "b n c"], bias: Float[Tensor, "h n n"]) -> Float[Tensor, "b n c"]:
        """States after this layer."""
        x = self.self_attn_layer_norm(self.residual * x + self.self_attn(x, bias))
        y: Tensor = self.final_layer_norm(self.residual * x + self.fc2(F.gelu(self.fc1(x))))
        return y


class BeatsEncoder(nn.Module):
    """The positional convolution and the transformer layers."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.config = config
        self.pos_conv = nn.Sequential(PositionConv(config))
        self.layers = nn.ModuleList(BeatsLayer(config) for _ in range(config.layers))
        self.layers[0].self_attn.relative_attention_bias = nn.Embedding(config.buckets, config.heads)  # type: ignore[union-attr]
        self.layer_norm = nn.LayerNorm(config.width)

    def forward(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """States of the patches."""
        x = self.layer_norm(x + self.pos_conv(x))
        table: nn.Embedding = self.layers[0].self_attn.relative_attention_bias  # type: ignore[assignment,union-attr]
        near = _relative_buckets(x.shape[1], self.config.buckets, self.config.farthest).to(x.device)
        bias = table(near).permute(2, 0, 1)
        for layer in self.layers:
            x = layer(x, bias)
        return x


class Beats(nn.Module):
    """Audio at 16 kHz in, one state every 160 ms out."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.config = config
        self.patch_embedding = nn.Conv2d(1, config.patch_width, PATCH, stride=PATCH, bias=False)
        self.layer_norm = nn.LayerNorm(config.patch_width)
        self.post_extract_proj = nn.Linear(config.patch_width, config.width)
        self.encoder = BeatsEncoder(config)

    def patches(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b n c"]:
        """States of all patches; those of one time step are adjacent, low bands first."""
        cut = self.patch_embedding(fbank(wave)[:, None]).flatten(2).transpose(1, 2)
        states: Tensor = self.encoder(self.post_extract_proj(self.layer_norm(cut)))
        return states

    def forward(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t c"]:
        """States in time, averaged over the frequency bands."""
        states = self.patches(wave)
        return states.view(len(states), -1, BANDS // PATCH, states.shape[2]).mean(2)

    @classmethod
    def from_published(cls, tensors: Mapping[str, Tensor]) -> Self:
        """Build from the tensors under `model` in a published file; sizes follow from their shapes.

        Raises:
            CheckpointError: the tensors belong to another model.
        """
        kept = {
            name: value
            for name, value in tensors.items()
            if not name.startswith("predictor") and (SHARED_BIAS not in name or ".layers.0." in name)
        }
        try:
            table = kept[f"encoder.layers.0.{SHARED_BIAS}"]
            taps = kept["encoder.pos_conv.0.weight_v"]
            hidden, width = kept["encoder.layers.0.fc1.weight"].shape
            config = BeatsConfig(
                layers=1 + max(int(name.split(".")[2]) for name in kept if ".layers." in name),
                width=width,
                heads=table.shape[1],
                hidden=hidden,
                patch_width=kept["patch_embedding.weight"].shape[0],
                buckets=table.shape[0],
                reach=taps.shape[2],
                groups=width // taps.shape[1],
            )
            model = cls(config)
            model.load_state_dict(kept)
        except (KeyError, ValueError, RuntimeError) as error:
            reason = str(error).split("\n")[-1].strip()[:160]
            raise CheckpointError(
                f"these are not BEATs weights ({reason}); use a file such as BEATs_iter3_plus_AS2M.pt"
            ) from error
        return model.eval()


def _relative_buckets(length: int, buckets: int, farthest: int) -> Int[Tensor, "n n"]:
    """Bucket of each distance: exact up close, logarithmic further away; the upper half of the buckets looks ahead."""
    at = torch.arange(length)
    ahead = at[None, :] - at[:, None]
    half = buckets // 2
    exact = half // 2
    far = ahead.abs()
    grown = exact + (torch.log(far.clamp(min=1) / exact) / torch.log(torch.tensor(farthest / exact)) * (half - exact))
    found = torch.where(far < exact, far, grown.long().clamp(max=half - 1))
    return found + half * (ahead > 0)
