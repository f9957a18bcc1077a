"""The warp model: sound in, how much to brake in each frame out.

The value of a frame may depend on all sound of its chunk, which has arrived before the motion is shown.
"""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.nn import Checkpointed, StreamingModule, StreamState

from ..face.encoder import MelEncoder, MelState
from .config import WarpConfig


@dataclass
class WarpModelState(StreamState):
    """All zero: silence before the start."""

    encoder: MelState


class WarpModel(Checkpointed, StreamingModule[WarpModelState]):
    """A mel encoder and one number read from each of its frames."""

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
        """How much to brake, 0 to 1, in each frame of the next chunks of sound (behind the level control)."""
        return self._decided(self.encoder.step(x, state.encoder, active))

    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b n"]:
        """`step` over a whole clip of whole chunks."""
        return self._decided(self.encoder(x))

    def logits(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """Logits of the curve, from the encoder's features; these are trained."""
        read: Tensor = self.read(features)
        return read[..., 0]

    def _decided(self, features: Float[Tensor, "b n c"]) -> Float[Tensor, "b n"]:
        """The curve made steeper: a trained curve hedges, and a body that brakes by half is never in time."""
        return (self.config.sharpness * self.logits(features) + self.config.eagerness).sigmoid()
