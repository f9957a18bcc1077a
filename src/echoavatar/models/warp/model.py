"""The warp model: sound in, a brake curve out, one value per frame.

A value may depend on all sound of its chunk, because the whole chunk has arrived before its motion is shown.
"""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import Checkpointed, StreamingModule, StreamState

from ..face.encoder import MelEncoder, MelState
from .config import WarpConfig


@dataclass
class WarpModelState(StreamState):
    """All zero is silence before the start."""

    encoder: MelState


class WarpModel(Checkpointed, StreamingModule[WarpModelState]):
    """A mel encoder and a linear read-out of one value per frame."""

    config_type = WarpConfig
    config: WarpConfig

    def __init__(self, config: WarpConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = MelEncoder(config.encoder)
        self.read = nn.Linear(config.encoder.outputs, 1)

    def init_state(self, rows: int) -> WarpModelState:
        """Nothing heard yet."""
        return WarpModelState(self.encoder.init_state(rows))

    def step(self, x: Float[Tensor, "b s"], state: WarpModelState, active: Bool[Tensor, " b"]) -> Float[Tensor, "b n"]:
        """The brake curve, 0 to 1, of the next chunks of sound (behind the level control)."""
        return self._sharpened(self.encoder.step(x, state.encoder, active))

    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b n"]:
        """`step` over a whole clip of whole chunks."""
        return self._sharpened(self.encoder(x))

    def logits(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """Logits of the curve from the encoder's features; training uses them."""
        logits: Tensor = self.read(features)
        return logits[..., 0]

    def _sharpened(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """The curve made steeper: a trained curve hedges, and a body that brakes by half is not in time."""
        return (self.config.sharpness * self.logits(features) + self.config.eagerness).sigmoid()
