"""Sizes of the face model (paper, appendix Face Animation Generator); the defaults are ours, and smaller."""

from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.timing import CHUNK_FRAMES, FRAMES_PER_MOTION_TOKEN


class MelConfig(Config):
    """Our own audio encoder: log-mel bands and convolutions; no frame sees beyond the end of its chunk."""

    kind: Literal["mel"] = "mel"
    bands: int = Field(default=40, gt=0, le=1024, description="mel bands")
    windows: int = Field(default=4, gt=0, le=800, description="mel windows per motion frame; must divide 800 samples")
    width: int = Field(default=128, gt=0, description="channels")
    blocks: int = Field(default=4, ge=0, le=64, description="convolution blocks")
    past: int = Field(default=6, ge=0, le=256, description="earlier frames that a block's kernel covers")
    ahead: int = Field(default=7, ge=0, le=7, description="later frames of the same chunk; 0 is frame-causal")

    @property
    def outputs(self) -> int:
        """Channels of a feature."""
        return self.width


class HubertConfig(Config):
    """Multilingual HuBERT, as in the paper; it encodes the last 63 frames anew for every chunk."""

    kind: Literal["hubert"] = "hubert"
    width: int = Field(default=768, gt=0, description="hidden size")
    layers: int = Field(default=12, gt=0, le=256, description="transformer layers")
    heads: int = Field(default=12, gt=0, description="attention heads")
    mlp: int = Field(default=3072, gt=0, description="intermediate size")
    convolutions: tuple[int, ...] = Field(default=(512,) * 7, description="channels of the waveform encoder")
    position_kernel: int = Field(default=128, gt=0, description="kernel of the positional convolution")
    position_groups: int = Field(default=16, gt=0, description="its groups")

    @property
    def outputs(self) -> int:
        """Channels of a feature."""
        return self.width


STILL = 1e-3  # channels that deviate less (standard deviation) are held at their mean
ChannelOrder = Literal["live_link", "apple"]


class FaceConfig(Config):
    """The whole model: encoder, causal GPT, flow-matching head."""

    encoder: MelConfig | HubertConfig = Field(default=MelConfig(), discriminator="kind")
    channels: int = Field(default=52, gt=0, description="ARKit curves")
    width: int = Field(default=128, gt=0, description="GPT channels (paper: 256)")
    layers: int = Field(default=4, gt=0, description="transformer blocks")
    heads: int = Field(default=8, gt=0, description="attention heads")
    context: int = Field(default=56, gt=1, le=4096, description="frames of motion history (paper: 56)")
    memory: Literal["ring", "window"] = Field(
        default="ring",
        description="ring: keys and values are kept from chunk to chunk; window: history is read anew (release)",
    )
    condition: int = Field(default=128, gt=0, description="channels from GPT to head (release: 52)")
    head_width: int = Field(default=128, gt=0, description="channels of the flow-matching head")
    head_blocks: int = Field(default=3, gt=0, description="AdaLN blocks of the head")
    head_split: bool = Field(
        default=False, description="two MLPs per block, steered by time and by condition (release), instead of one"
    )
    sampling_steps: int = Field(default=3, gt=0, le=1000, description="Euler steps of a frame")
    guidance: float = Field(default=2.0, ge=0, description="classifier-free guidance; 1 is none")
    noise_hold: int = Field(
        default=16, gt=0, le=4096, description="frames from one independent draw of noise to the next (paper: 1)"
    )

    step: int = Field(
        default=CHUNK_FRAMES,
        gt=0,
        le=256,
        description="frames of a step: 4 or 8 in the ring form, others (release: 12) in the window form",
    )
    late: int = Field(
        default=0,
        ge=0,
        le=2,
        description="delay of the face in frames, so that the ends of chunks hear what follows (paper: 0)",
    )
    order: ChannelOrder = Field(
        default="live_link", description="of the model's channels; they differ in left and right of jaw and mouth"
    )
    least_std: float = Field(default=0.02, ge=0, description="least deviation by which a channel is normalised")
    idle: bool = Field(default=True, description="whether channels that hardly move get idle motion")

    @property
    def least_scale(self) -> float:
        """`least_std`, but never 0, because channels are divided by it."""
        return max(self.least_std, 1e-8)

    @model_validator(mode="after")
    def _heads_divide_width(self) -> Self:
        if self.memory == "ring" and self.step not in (FRAMES_PER_MOTION_TOKEN, CHUNK_FRAMES):
            raise ValueError(f"the ring form steps by {FRAMES_PER_MOTION_TOKEN} or {CHUNK_FRAMES} frames")
        if isinstance(self.encoder, MelConfig) and self.encoder.ahead >= self.step:
            raise ValueError(f"a step of {self.step} frames has no {self.encoder.ahead} later ones for the encoder")
        if self.width % self.heads:
            raise ValueError(f"width ({self.width}) must be a multiple of heads ({self.heads})")
        if self.head_split and self.memory == "ring":
            raise ValueError("head_split goes with memory window only")
        if self.width % 2 or self.head_width % 2:
            raise ValueError(f"width ({self.width}) and head_width ({self.head_width}) must be even")
        return self
