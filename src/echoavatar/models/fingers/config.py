"""Sizes of the finger model; the paper (Motion Refinement) gives none."""

from typing import Self

from pydantic import Field, model_validator

from echoavatar.config import Config

from .hand_poses import HAND_SIZE


class FingerConfig(Config):
    """A small transformer without causal mask."""

    frames: int = Field(default=64, gt=0, le=4096, description="frames of a window, at 30 per second")
    patch: int = Field(default=4, gt=0, le=4096, description="frames that share a token; must divide the window")
    width: int = Field(default=128, gt=0, description="channels")
    layers: int = Field(default=3, gt=0, description="transformer blocks")
    heads: int = Field(default=4, gt=0, description="attention heads")
    poses: int = Field(default=24, gt=0, le=HAND_SIZE, description="principal directions of one hand's pose")

    @model_validator(mode="after")
    def _sizes_fit(self) -> Self:
        if self.frames % self.patch:
            raise ValueError(f"patch ({self.patch}) must divide frames ({self.frames})")
        if self.width % (2 * self.heads):
            raise ValueError(f"width ({self.width}) must be a multiple of twice the heads ({self.heads})")
        return self
