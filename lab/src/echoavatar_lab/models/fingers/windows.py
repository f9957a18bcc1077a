"""Training data and loss of the finger model: windows of clips, noise on the hands, denoising error.

All randomness of a step follows from seed and step number.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.models.fingers.clips import FingerClip, mirror_body
from echoavatar.models.fingers.model import FingerModel

from .recipe import FingerTraining


class FingerBatch(NamedTuple):
    """Windows: normalised body features, hand coordinates, and which hands move."""

    body: Float[Tensor, "b t c"]
    hands: Float[Tensor, "b t 2 k"]
    is_moving: Bool[Tensor, "b 2"]


class FingerSampler:
    """Draws windows from groups of clips and mirrors half of them; deterministic for seed and step."""

    def __init__(
        self, model: FingerModel, groups: Sequence[Sequence[FingerClip]], shares: Sequence[float], *, seed: int
    ) -> None:
        """Clips must be at least as long as a window; `shares` are the probabilities of the groups."""
        frames = model.config.frames
        clips = [clip for group in groups for clip in group]
        self._shares, self._seed, self._frames = torch.tensor(shares), seed, frames
        self._model, self._body = model, torch.cat([clip.body for clip in clips])
        self._hands = torch.cat([model.basis.encode(clip.hands) for clip in clips])
        self._is_moving = torch.stack([clip.is_moving for clip in clips])
        ends = torch.tensor([len(clip.body) for clip in clips]).cumsum(0).tolist()
        starts = [torch.arange(end - len(clip.body), end - frames + 1) for clip, end in zip(clips, ends, strict=True)]
        numbers = iter(range(len(clips)))
        members = [[next(numbers) for _ in group] for group in groups]
        self._starts = [torch.cat([starts[i] for i in group]) for group in members]
        self._owners = [torch.cat([torch.full((len(starts[i]),), i) for i in group]) for group in members]

    def batch(self, step: int, rows: int) -> FingerBatch:
        """Draw the windows of one step."""
        random = torch.Generator().manual_seed(self._seed * 1_000_003 + step)
        groups = torch.multinomial(self._shares, rows, replacement=True, generator=random)
        places = torch.rand(rows, generator=random)
        first, owner = torch.zeros(2, rows, dtype=torch.int64)
        for row, group in enumerate(groups.tolist()):
            at = int(places[row] * len(self._starts[group]))
            first[row], owner[row] = self._starts[group][at], self._owners[group][at]
        window = first[:, None] + torch.arange(self._frames)
        body, hands, is_moving = self._body[window], self._hands[window], self._is_moving[owner]
        is_flipped = torch.rand(rows, generator=random) < 0.5
        body = torch.where(is_flipped[:, None, None], mirror_body(body), body)
        hands = torch.where(is_flipped[:, None, None, None], hands.flip(2), hands)
        is_moving = torch.where(is_flipped[:, None], is_moving.flip(1), is_moving)
        return FingerBatch(self._model.normalize_body(body), hands, is_moving)


class FingerNoise(NamedTuple):
    """All random numbers in the loss of a batch; `pure` to `side` and `body_chance` are uniform, the rest normal."""

    pure: Float[Tensor, " b"]
    level: Float[Tensor, " b"]
    given: Float[Tensor, " b"]
    side: Float[Tensor, " b"]
    hands: Float[Tensor, "b t 2 k"]
    body_chance: Float[Tensor, "b 2 1 1"]
    body_noise: Float[Tensor, "b t c"]
    offset: Float[Tensor, "b 1 c"]


def draw_noise(batch: FingerBatch, random: torch.Generator) -> FingerNoise:
    """Draw noise for a batch."""
    rows, _, channels = batch.body.shape
    pure, level, given, side = (torch.rand(rows, generator=random) for _ in range(4))
    hands = torch.randn(batch.hands.shape, generator=random)
    chance = torch.rand(2, rows, 1, 1, generator=random).transpose(0, 1)
    body_noise = torch.randn(batch.body.shape, generator=random)
    offset = torch.randn(rows, 1, channels, generator=random)
    return FingerNoise(pure, level, given, side, hands, chance, body_noise, offset)


def denoising_loss(
    model: FingerModel, batch: FingerBatch, training: FingerTraining, random: FingerNoise
) -> Float[Tensor, ""]:
    """Squared error of the predicted hands and of their frame-to-frame differences, over unknown moving hands.

    Hands that do not move in the clip are neither shown nor learned from.
    """
    rows, frames = batch.hands.shape[:2]
    level = torch.where(random.pure < training.pure_noise, 1.0, random.level.sqrt())
    given = (random.given < training.one_known).long() * (1 + (random.side < 0.5).long())  # 0 none, 1, 2
    is_known = (given[:, None] == torch.tensor([1, 2], device=given.device)) & batch.is_moving
    share = torch.where(batch.is_moving, level[:, None], 1.0)[:, None, :, None]
    noisy = (1 - share) * batch.hands + share * random.hands
    shown = is_known[:, None].expand(rows, frames, 2)
    seen = torch.where(shown[..., None], batch.hands, noisy)
    error = model(seen, shown, level, _disturbed(batch.body, training, random)) - batch.hands
    weight = (batch.is_moving & ~is_known).float()[:, None, :, None]
    total = (weight.sum() * error.shape[-1]).clamp_min(1)
    still = (weight * error.square()).sum() / frames
    steps = (weight * error.diff(dim=1).square()).sum() / max(1, frames - 1)
    loss: Tensor = (still + training.speed_weight * steps) / total
    return loss


def count_learned_hands(batch: FingerBatch, training: FingerTraining, random: FingerNoise) -> float:
    """Number of hands in the loss of a batch, at least one."""
    given = (random.given < training.one_known).long() * (1 + (random.side < 0.5).long())
    is_known = given[:, None] == torch.tensor([1, 2], device=given.device)
    return float((batch.is_moving & ~is_known).sum().clamp_min(1))


def _disturbed(body: Float[Tensor, "b t c"], training: FingerTraining, random: FingerNoise) -> Float[Tensor, "b t c"]:
    """Body features with noise and with offsets that are constant over a window.

    The clips show few people; without this augmentation the model does not generalise to other postures.
    """
    noise = training.body_noise * random.body_chance[:, 0] * random.body_noise
    offset = training.body_offset * random.body_chance[:, 1] * random.offset
    return body + noise + offset
