"""The face model whole: encoder, GPT, head, and the statistics of the curves it was trained on.

Paper, appendix Face Animation Generator: 52 ARKit coefficients from streaming audio, normalised per channel.
"""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.models.face import FaceConfig, FaceStream, MelConfig
from echoavatar.models.face.config import STILL
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.nn.torch_step import TorchStep

from .encoder import AudioEncoder, HubertEncoder, MelEncoder
from .flow import FlowHead
from .gpt import FaceGpt
from .window import WindowFrames


class FaceModel(Checkpointed):
    """Encoder, backbone, head and the statistics of the curves; `stream` runs it."""

    config_type = FaceConfig
    config: FaceConfig
    mean: Tensor
    std: Tensor

    def __init__(self, config: FaceConfig) -> None:
        super().__init__()
        self.config = config
        sizes = config.encoder
        self.encoder: AudioEncoder[Any] = (
            MelEncoder(sizes, config.step) if isinstance(sizes, MelConfig) else HubertEncoder(sizes)
        )
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
        """What the frames of the next chunks hear; `state` is the encoder's. The window form keeps features instead."""
        heard: Tensor = self.encoder.step(x, state, active)
        return self.gpt.sound_proj(heard) if self.config.memory == "ring" else heard

    def stream(self, *, has_idle: bool = True) -> FaceStream:
        """The model at work; see `FaceStream`."""
        weights = {name: weight.numpy() for name, weight in self.eval().state_dict().items()}
        ear, frames = TorchStep(self.hear, self.encoder.init_state), None
        if self.config.memory == "window":
            window = WindowFrames(self)
            frames = TorchStep(window.step, window.init_state)
        return FaceStream(self.config, weights, ear, frames, has_idle=has_idle)

    def denormalize(self, normal: Float[Tensor, "*b c"]) -> Float[Tensor, "*b c"]:
        """Curves from normalised ones; not clamped."""
        return normal * self.scale() * self.moving() + self.mean

    def moving(self) -> Float[Tensor, " c"]:
        """1 for the channels that this model moves, 0 for the others."""
        return (self.std > STILL).to(self.std)

    def scale(self) -> Float[Tensor, " c"]:
        """The deviation by which each channel is normalised."""
        return self.std.clamp_min(self.config.least_scale)
