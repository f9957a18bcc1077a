"""Losses of the face model: flow matching, the opening of the lips, and a readout of the encoder.

Paper, Face Animation Generator: MSE flow matching. Our additions: the gap between the lips has a weight of its
own, and the face is also predicted from the encoder alone (`FaceReader`). Through the flow head the encoder learns
little, because the previous frame predicts most of a face; but it does not predict that the lips will close.
"""

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.models.face.flow import FULL_NOISE, add_noise
from echoavatar.models.face.model import FaceModel
from echoavatar.motion.arkit import ARKIT_NAMES

from .recipe import FaceTraining
from .windows import FaceBatch

TOUCHING = 0.05  # gap of closed lips, as a share of the jaw's range


class FaceReader(nn.Module):
    """A linear readout of the encoder's features: the face (normalised), and whether the lips touch (logit)."""

    def __init__(self, features: int, channels: int) -> None:
        super().__init__()
        self.read = nn.Linear(features, channels + 1)

    def loss(
        self, model: FaceModel, features: Float[Tensor, "b t a"], curves: Float[Tensor, "b t c"]
    ) -> Float[Tensor, ""]:
        """Squared error over the channels that move, and cross-entropy of touching."""
        read, moving = self.read(features), model.moving()
        error = (read[..., :-1] - model.normalize(curves)).square() * moving
        touching = (_apart(curves) <= TOUCHING).to(read)
        far: Tensor = error.sum() / (read[..., 0].numel() * moving.sum().clamp_min(1))
        return far + F.binary_cross_entropy_with_logits(read[..., -1], touching)


class FlowNoise(NamedTuple):
    """All random numbers in the loss of a batch."""

    strength: Float[Tensor, "b 1 1"]  # of the noise on a window's history, in its largest
    history: Float[Tensor, "b t c"]
    keeps_history: Float[Tensor, "b 1 1"]  # 0 where the history is dropped
    keeps_sound: Float[Tensor, "b 1 1"]
    level: Float[Tensor, "b n t"]  # of the noise on the frames to predict, uniform
    noise: Float[Tensor, "b n t c"]


def draw_noise(curves: Float[Tensor, "b t c"], training: FaceTraining, random: torch.Generator) -> FlowNoise:
    """Noise for windows of these sizes."""
    rows, frames, channels = curves.shape
    strength = torch.rand(rows, 1, 1, generator=random)
    history = torch.randn(rows, frames, channels, generator=random)
    keeps_history, keeps_sound = (
        (torch.rand(rows, 1, 1, generator=random) >= share).float()
        for share in (training.history_dropout, training.audio_dropout)
    )
    shape = (training.draws, rows, frames)
    level = torch.rand(shape, generator=random)
    noise = torch.randn(*shape, channels, generator=random)
    return FlowNoise(strength, history, keeps_history, keeps_sound, level.transpose(0, 1), noise.transpose(0, 1))


def flow_loss(
    model: FaceModel, batch: FaceBatch, training: FaceTraining, random: FlowNoise, *, features: Float[Tensor, "b t a"]
) -> Float[Tensor, ""]:
    """Squared error of the clean face seen behind noise (normalised), over the channels that move, and of the lips.

    `features` are the encoder's, of the batch's sound.
    """
    clean = model.normalize(batch.curves)
    history = torch.cat([model.normalize(batch.before)[:, None], clean[:, :-1]], 1)
    noisy = history + training.history_noise * random.strength * random.history
    history = noisy * random.keeps_history * model.moving()
    sound = model.gpt.sound_proj(features) * random.keeps_sound
    condition = model.gpt(history, sound)
    shape = (training.draws, *clean.shape[:2])
    level = random.level.transpose(0, 1).contiguous() ** (1 / training.high_noise)
    times = (level * FULL_NOISE).ceil().long().clamp(1, FULL_NOISE)
    noise = random.noise.transpose(0, 1).contiguous()
    seen = model.head(add_noise(clean.expand(*shape, -1), noise, times), times, condition.expand(*shape, -1))
    error = (seen - clean).square() * model.moving()
    loss: Tensor = error.sum() / (math.prod(shape) * model.moving().sum().clamp_min(1))
    return loss + training.lips * lip_error(model.denormalize(seen), batch.curves) if training.lips else loss


def lip_error(seen: Float[Tensor, "n b t c"], curves: Float[Tensor, "b t c"]) -> Float[Tensor, ""]:
    """Squared error of the gap between the lips, in tenths of the jaw's range; closed lips weigh most."""
    wanted = _apart(curves)
    weight = torch.where(wanted <= TOUCHING, 4.0, 1.0)
    return (weight * (_apart(seen) - wanted).square()).mean() * 100


def _apart(curves: Float[Tensor, "*b c"]) -> Float[Tensor, "*b"]:
    return curves[..., ARKIT_NAMES.index("jawOpen")] - curves[..., ARKIT_NAMES.index("mouthClose")]
