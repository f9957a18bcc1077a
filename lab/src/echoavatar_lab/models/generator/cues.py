"""An auxiliary task of training: the middle layer predicts beats and stressed syllables (not in the paper).

Motion codes are well predicted by the codes before them, so a small model hardly learns from them when a stroke is due.
Trained on the events themselves it learns them within a few hundred steps. The layer matters: no other position can
read the output of the last one. So the middle layer predicts, at each audio frame, whether a cue is on; one layer
later, each motion token's first position predicts which frames of its chunk hold cues, which the layers above it need
to place a stroke. In the depth order both are the same position, which hears ten audio frames and predicts their cues.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from echoavatar.models.generator.config import AUDIO_FRAMES_PER_TOKEN
from echoavatar.models.generator.model import Generator
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK

from .windows import CUES

ON_WEIGHT = 16.0  # cues are on for about one frame in thirty


class CueReader(nn.Module):
    """Two linear readouts (depth order: one) of a generator's hidden states while it trains.

    The generator itself stays as it is.
    """

    def __init__(self, generator: Generator) -> None:
        super().__init__()
        width = generator.config.width
        self._frames = 1 if generator.depth is None else AUDIO_FRAMES_PER_TOKEN  # that a position hears
        self.now = nn.Linear(width, self._frames * len(CUES))
        self.when = nn.Linear(width, AUDIO_FRAMES_PER_CHUNK * len(CUES)) if generator.depth is None else None
        self._order = generator.config.order
        self._states: dict[str, Tensor] = {}
        layers = generator.model.layers
        layers[(len(layers) - 1) // 2].register_forward_hook(self._keep("now"))
        if self.when is not None:
            layers[len(layers) // 2].register_forward_hook(self._keep("when"))

    def _keep(self, name: str) -> Any:
        def hook(module: nn.Module, inputs: tuple[Any, ...], output: Tensor) -> None:
            if module.training:
                self._states[name] = F.rms_norm(output, output.shape[-1:])

        return hook

    def loss(self, cues: Int[Tensor, "b f 2"], predictors: Int[Tensor, "k n"]) -> Float[Tensor, ""]:
        """Mean of the readouts' cross-entropies on the states of the generator's last forward pass.

        `predictors` are those of the sequences: row 0 holds each motion token's first position.
        """
        rows, frames, kinds = cues.shape
        now = self._states.pop("now")
        cues = cues.to(now.device)
        if self.when is None:
            return cue_loss(self.now(now), cues.view(rows, -1, self._frames * kinds))
        when = self._states.pop("when")
        heard = self._order.heard(frames // AUDIO_FRAMES_PER_CHUNK).to(now.device)
        by_chunk = cues.view(rows, -1, AUDIO_FRAMES_PER_CHUNK * kinds)
        of_token = by_chunk.repeat_interleave(MOTION_TOKENS_PER_CHUNK, 1)
        return 0.5 * (cue_loss(self.now(now[:, heard]), cues) + cue_loss(self.when(when[:, predictors[0]]), of_token))


def cue_loss(logits: Float[Tensor, "*any"], cues: Int[Tensor, "*any"]) -> Float[Tensor, ""]:
    """Cross-entropy of cues on or off, the rare ones that are on weighted up."""
    weight = torch.full((), ON_WEIGHT, device=logits.device)
    return F.binary_cross_entropy_with_logits(logits.float(), cues.to(logits).float(), pos_weight=weight)
