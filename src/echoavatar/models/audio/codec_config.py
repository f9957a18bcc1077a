"""Sizes of the audio codec."""

from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.timing import SAMPLES_PER_AUDIO_TOKEN

CODE_LAYERS = 2
"""RVQ layers in use (paper, Settings: the first two of EnCodec); no others are ever computed."""


class CodecConfig(Config):
    """A causal EnCodec (24 kHz, 75 frames per second).

    The defaults are the small codec of the bundle. Departs from `facebook/encodec_24khz` in size, and in padding
    with zeros instead of reflections, so that a stream may start with a chunk of any length and the first frames
    of a clip are coded like all others.
    """

    filters: int = Field(default=8, gt=0, description="channels after the first convolution; doubled at each ratio")
    width: int = Field(default=64, gt=0, description="latent channels")
    codes: int = Field(default=512, gt=1, description="entries of each codebook; a power of two")
    ratios: tuple[int, ...] = Field(default=(8, 5, 4, 2), description="upsampling ratios of the decoder")
    lstm_layers: int = Field(default=2, gt=0, le=16, description="LSTM layers in encoder and decoder")
    residual_blocks: int = Field(default=0, ge=0, le=16, description="residual blocks per ratio")
    kernel: int = Field(default=7, gt=0, le=1024, description="samples seen by the first convolution")
    last_kernel: int = Field(default=7, gt=0, le=1024, description="frames seen by the last convolution")
    residual_kernel: int = Field(default=3, gt=0, le=1024, description="kernel inside the residual blocks")
    dilation_growth: int = Field(default=2, gt=0, le=16, description="dilation from one residual block to the next")
    compress: int = Field(default=2, gt=0, description="channel reduction inside the residual blocks")
    has_conv_shortcut: bool = Field(default=False, description="a 1x1 convolution beside each residual block")
    padding: Literal["constant", "reflect"] = Field(
        default="constant", description="what stands before the first sample"
    )

    @model_validator(mode="after")
    def _ratios_give_the_clock(self) -> Self:
        product = 1
        for ratio in self.ratios:
            product *= ratio
        if product != SAMPLES_PER_AUDIO_TOKEN:
            raise ValueError(f"the product of ratios is {product}, wanted {SAMPLES_PER_AUDIO_TOKEN}")
        if self.codes & (self.codes - 1):
            raise ValueError(f"codes ({self.codes}) must be a power of two")
        return self
