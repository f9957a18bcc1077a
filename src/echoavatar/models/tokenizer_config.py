"""Sizes of the motion tokenizer."""

from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.motion.kinematics import Skeleton, SkeletonConfig, part_sizes


class MotionTokenizerConfig(Config):
    """Sizes of one part's tokenizer; the defaults are the paper recipe's."""

    features: int = Field(gt=0, description="channels of the motion features")
    width: int = Field(default=512, gt=0, description="latent channels")
    heads: int = Field(default=8, gt=0, description="attention heads")
    lookback: int = Field(default=15, ge=0, le=1024, description="past frames each frame may see")
    layers: int = Field(default=6, gt=0, le=64, description="RVQ layers Q")
    codes: int = Field(default=512, gt=1, description="codes per layer K")
    decay: float = Field(default=0.99, gt=0, lt=1, description="moving average of the codebooks")
    dead_below: float = Field(default=1.0, ge=0, description="average use per step under which a code is replaced")
    kmeans_steps: int = Field(default=0, ge=0, le=10000, description="k-means steps when the codebooks are initialised")
    blocks: Literal["attention", "convolution"] = Field(
        default="attention", description="layers that look back; convolutions are the paper's baseline"
    )
    resampling: Literal["dual", "learned", "strided"] = Field(
        default="dual",
        description="between levels: mean and MLP (the paper's dual path), the MLP alone, or one strided convolution",
    )

    @model_validator(mode="after")
    def _heads_divide_width(self) -> Self:
        if self.width % (2 * self.heads):
            raise ValueError(f"width ({self.width}) must be a multiple of twice the heads ({self.heads})")
        return self

    def lookback_at(self, level: int) -> int:
        """Past positions besides itself at a level: 15, 7, 3 for a look-back of 15 frames."""
        return max(((self.lookback + 1) >> level) - 1, 0)


class BodyTokenizerConfig(Config):
    """A skeleton and the sizes of each part's tokenizer."""

    skeleton: SkeletonConfig = Field(description="the rig whose features are tokenised")
    parts: dict[str, MotionTokenizerConfig] = Field(description="sizes of each part, in the skeleton's order")

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        sizes = part_sizes(Skeleton(self.skeleton))
        if {name: part.features for name, part in self.parts.items()} != sizes:
            raise ValueError(f"the parts must be those of the skeleton with their features, {sizes}")
        if len({(part.layers, part.codes) for part in self.parts.values()}) != 1:
            raise ValueError("all parts must have the same number of layers and codes")
        return self

    @property
    def layers(self) -> int:
        """RVQ layers Q of every part."""
        return next(iter(self.parts.values())).layers

    @property
    def codes(self) -> int:
        """Codes per layer K of every part."""
        return next(iter(self.parts.values())).codes
