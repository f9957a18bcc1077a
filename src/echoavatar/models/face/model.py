"""The face model whole: encoder, GPT, head, and the statistics of the curves it was trained on.

Paper, appendix Face Animation Generator: 52 ARKit coefficients from streaming audio, normalised per channel.
"""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.checkpoint import Checkpointed

from .config import FaceConfig, MelConfig
from .encoder import AudioEncoder, HubertEncoder, MelEncoder
from .flow import FlowHead
from .gpt import FaceGpt

_TINY = 1e-8
STILL = 1e-3  # channels that deviate less (standard deviation) are held at their mean


class FaceModel(Checkpointed):
    """Encoder, backbone, head and the statistics of the curves; `FaceStream` runs it."""

    config_type = FaceConfig
    config: FaceConfig
    mean: Tensor
    std: Tensor

    def __init__(self, config: FaceConfig) -> None:
        super().__init__()
        self.config = config
        sizes = config.encoder
        self.encoder: AudioEncoder[Any] = MelEncoder(sizes) if isinstance(sizes, MelConfig) else HubertEncoder(sizes)
        self.gpt = FaceGpt(config)
        self.head = FlowHead(
            channels=config.channels,
            condition=config.condition,
            width=config.head_width,
            blocks=config.head_blocks,
            split=config.head_split,
        )
        self.register_buffer("mean", torch.zeros(config.channels))
        self.register_buffer("std", torch.ones(config.channels))

    def hear(self, x: Float[Tensor, "b s"], state: Any, active: Bool[Tensor, " b"]) -> Float[Tensor, "b n w"]:
        """What the frames of the next chunks hear (ring form); `state` is the encoder's."""
        heard: Tensor = self.gpt.sound_proj(self.encoder.step(x, state, active))
        return heard

    def denormalize(self, normal: Float[Tensor, "*b c"]) -> Float[Tensor, "*b c"]:
        """Curves from normalised ones; not clamped."""
        return normal * self.scale() * self.moving() + self.mean

    def moving(self) -> Tensor:
        """1 for the channels that this model moves, 0 for the others (c)."""
        return (self.std > STILL).to(self.std)

    def scale(self) -> Tensor:
        """The deviation by which each channel is normalised (c)."""
        return self.std.clamp_min(max(self.config.least_std, _TINY))
