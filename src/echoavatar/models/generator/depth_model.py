"""The depth order: a backbone that reads a motion time step at once, and a small transformer over its codes.

Not in the paper, which flattens all ids into one sequence; after RQ-Transformer and Moshi. The backbone runs at 7.5 Hz:
its input is the sound of the frame (the layers of each audio frame summed, the ten audio frames mapped together) and
the last motion frame (the sum of its code embeddings). The depth transformer then predicts the frame's 3 Q codes in the
order of the segments. Each of its positions gets the backbone's hidden state and the code before. So the large
transformer runs once for 3 Q codes and 20 audio ids, where the flattened one runs 3 Q + 20 times.
"""

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from .config import AUDIO_FRAMES_PER_TOKEN, GeneratorConfig

if TYPE_CHECKING:
    from .model import Body


class DepthReader(nn.Module):
    """What a generator of the depth order has beside its backbone and its heads."""

    def __init__(self, config: GeneratorConfig, body: "Body") -> None:
        """`body` is the transformer over codes, with an embedding table of its own."""
        super().__init__()
        self.config, self.body = config, body
        self.sound = nn.Linear(AUDIO_FRAMES_PER_TOKEN * config.width, config.width, bias=False)
        self.condition = nn.Linear(config.width, config.depth_width, bias=False)

    @torch.no_grad()
    def balance(self) -> None:
        """Make the backbone's hidden state, which is normed, as small as the embedded codes that it is added to."""
        self.condition.weight.mul_(self.config.width**-0.5)

    def forward(
        self,
        backbone: "Body",
        ids: Int[Tensor, "b t"],
        hints: Float[Tensor, "b n c"] | None,
        asked: Int[Tensor, " f"] | None = None,
    ) -> Float[Tensor, "b m d"]:
        """The hidden state that predicts each code, frame after frame; see `tokens.Depth` for the ids.

        With `asked`, of these frames alone: the backbone reads all.
        """
        sizes = self._sizes
        sound, moves = torch.split(ids.view(len(ids), -1, sum(sizes)), sizes, dim=2)
        x = self.heard(backbone, sound) + self.moved(backbone, moves)
        x = x if hints is None else x + hints
        hidden = self._run(backbone, x)
        return self.codes(hidden, moves) if asked is None else self.codes(hidden[:, asked], moves[:, asked])

    def apart(
        self, backbone: "Body", sound: Int[Tensor, "b t"], moves: Int[Tensor, "b m"]
    ) -> tuple[Float[Tensor, "b t d"], Float[Tensor, "b m d"]]:
        """The hidden states that predict each audio id from sound alone, and each motion id from motion alone."""
        sounds, codes = (ids.view(len(ids), -1, size) for ids, size in zip((sound, moves), self._sizes, strict=True))
        heard = torch.cat([self._start(backbone, sound), self.heard(backbone, sounds)[:, :-1]], dim=1)
        by_sound, by_motion = self._run(backbone, heard), self._run(backbone, self.moved(backbone, codes))
        return self.codes(by_sound, sounds), self.codes(by_motion, codes)

    @property
    def _sizes(self) -> list[int]:
        """Audio ids and motion ids of a frame."""
        layout = self.config.layout
        return [AUDIO_FRAMES_PER_TOKEN * layout.audio_layers, layout.segments]

    def _run(self, backbone: "Body", x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        frames = torch.arange(x.shape[1], device=x.device)[None]
        hidden: Tensor = backbone(x, frames, self.config.order.lookback)
        return hidden

    def _start(self, backbone: "Body", ids: Int[Tensor, "b t"]) -> Float[Tensor, "b 1 c"]:
        start: Tensor = backbone.embed_tokens(torch.full_like(ids[:, :1], self.config.layout.start_id))
        return start

    def heard(self, backbone: "Body", sound: Int[Tensor, "b n i"]) -> Float[Tensor, "b n c"]:
        """The backbone's input from the audio ids of each frame."""
        by_layer = backbone.embed_tokens(sound).unflatten(2, (AUDIO_FRAMES_PER_TOKEN, -1))
        heard: Tensor = self.sound(by_layer.sum(3).flatten(2))
        return heard

    def moved(self, backbone: "Body", moves: Int[Tensor, "b n k"]) -> Float[Tensor, "b n c"]:
        """The backbone's input from the motion ids of the frame before; the start id stands before the first."""
        return torch.cat([self._start(backbone, moves[:, :, 0]), backbone.embed_tokens(moves[:, :-1]).sum(2)], dim=1)

    def codes(self, hidden: Float[Tensor, "b n c"], ids: Int[Tensor, "b n k"]) -> Float[Tensor, "b m d"]:
        """The hidden state that predicts each id of each frame, from the backbone's and the ids before in the frame."""
        rows, _, count = ids.shape
        before = F.pad(self.body.embed_tokens(ids[..., :-1]), (0, 0, 1, 0))
        x = (before + self.condition(hidden)[:, :, None]).flatten(0, 1)
        places = torch.arange(count, device=ids.device)[None]
        read: Tensor = self.body(x, places, None)
        return read.view(rows, -1, read.shape[2])
