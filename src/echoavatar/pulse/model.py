"""The pulse model: sound in, how much to brake in each frame out.

A frame's answer may use all sound of its own chunk, as the face's may: it was heard before the motion is shown.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from .. import checkpoint
from ..face.encoder import MelEncoder, MelState
from ..nn import StreamingModule, StreamState
from .config import PulseConfig


@dataclass
class PulseState(StreamState):
    """Zero is silence before the start."""

    encoder: MelState


class PulseModel(StreamingModule[PulseState]):
    """A mel encoder and one number read from each of its frames."""

    def __init__(self, config: PulseConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = MelEncoder(config.encoder)
        self.read = nn.Linear(config.encoder.outputs, 1)

    def init_state(self, rows: int) -> PulseState:
        """Nothing heard yet."""
        return PulseState(self.encoder.init_state(rows))

    def step(
        self, x: Float[Tensor, "b s"], state: PulseState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b n"]:
        """How much to brake, 0 to 1, in each frame of the next chunks of sound (behind the level control)."""
        return self._decided(self.encoder.step(x, state.encoder, active))

    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b n"]:
        """The same of a whole clip of whole chunks."""
        return self._decided(self.encoder(x))

    def logits(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """What is trained, from the encoder's features: the logits of the curve itself."""
        read: Tensor = self.read(features)
        return read[..., 0]

    def _decided(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """The curve made steeper: it was trained to hedge, and a body that half brakes is in time with nothing."""
        return (self.config.sharpness * self.logits(features) + self.config.eagerness).sigmoid()

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder.

        Raises:
            CheckpointError: something is missing or does not fit.
        """
        return checkpoint.load(folder, PulseConfig, cls).eval()

    def save(self, folder: Path, card: Mapping[str, object], *, dtype: torch.dtype | None = None) -> None:
        """Write a checkpoint folder."""
        checkpoint.save(folder, config=self.config, weights=self.state_dict(), card=card, dtype=dtype)
