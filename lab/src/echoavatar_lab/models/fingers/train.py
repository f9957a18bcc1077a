"""Training of the finger model on motion with good fingers: windows of clips, noise on the hands, denoising error.

The paper (Motion Refinement) trains on ZeroEGGS, whose licence does not allow sharing the weights, and gives no
settings. The shipped model is trained on synthetic and recorded clips in a fixed ratio. All randomness of a step
follows from seed and step number.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar_lab.models.fingers.clips import HAND_FEATURES, MIRROR_6D, FingerClip, HandBasis
from echoavatar_lab.models.fingers.model import FingerConfig, FingerModel
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, seeded


def mirror_body(features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
    """Features of the mirrored clip; exact, because only signs and order change."""
    hands, hips = torch.split(features, [2 * HAND_FEATURES, 3], -1)
    flip = features.new_tensor([-1.0, 1, 1])
    swapped = hands.reshape(*hands.shape[:-1], 2, HAND_FEATURES).flip(-2)
    hands = (swapped * torch.cat([flip, flip, features.new_tensor(MIRROR_6D), flip])).flatten(-2)
    return torch.cat([hands, hips * features.new_tensor([1.0, -1, 1])], -1)


class FingerTraining(TrainingConfig):
    """Schedule, data mix and noise of finger training."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=32, gt=0, description="windows per step")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule")
    final_rate: float = Field(default=0.03, ge=0, le=1, description="share of the peak at the end of the cosine")
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's decay rates")
    recorded: float = Field(default=0.3, ge=0, le=1, description="share of windows from recorded clips, if any")
    one_known: float = Field(default=0.25, ge=0, le=1, description="share of windows with one hand given")
    pure_noise: float = Field(default=0.3, ge=0, le=1, description="share of windows with pure noise")
    body_noise: float = Field(
        default=0.15, ge=0, description="largest deviation of the noise on body features, in standard deviations"
    )
    body_offset: float = Field(
        default=0.5,
        ge=0,
        description="the same for an offset that is constant over a window, which stands for other people and rigs",
    )
    speed_weight: float = Field(default=10.0, ge=0, description="weight of the error of frame-to-frame differences")


def fit_basis(hands: Float[Tensor, "n c"], size: int) -> HandBasis:
    """The `size` directions with most of the variance of hand poses.

    Coordinates are divided by the root of their standard deviation, so that small directions count and large ones still
    count more.
    """
    wide = hands.double()
    mean = wide.mean(0)
    values, vectors = torch.linalg.eigh((wide - mean).T @ (wide - mean) / len(wide))
    spread = values.flip(0)[:size].clamp_min(1e-8).sqrt()
    scale = (spread * spread.mean()).sqrt()
    return HandBasis(mean.float(), vectors.flip(1)[:, :size].T.contiguous().float(), scale.float())


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
    is_known = _known(training, random) & batch.is_moving
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
    return float((batch.is_moving & ~_known(training, random)).sum().clamp_min(1))


def _known(training: FingerTraining, random: FingerNoise) -> Bool[Tensor, "b 2"]:
    """Which hands are given, left and right: at most one of a window."""
    is_right = random.side < 0.5
    return (random.given < training.one_known)[:, None] & torch.stack([~is_right, is_right], 1)


def _disturbed(body: Float[Tensor, "b t c"], training: FingerTraining, random: FingerNoise) -> Float[Tensor, "b t c"]:
    """Body features with noise and with offsets that are constant over a window.

    The clips show few people; without this augmentation the model does not generalise to other postures.
    """
    noise = training.body_noise * random.body_chance[:, 0] * random.body_noise
    offset = training.body_offset * random.body_chance[:, 1] * random.offset
    return body + noise + offset


_NOISE = 30  # factor of the seed, so that noise and windows of a step differ


class NoisyFingerBatch(NamedTuple):
    """A batch: windows and all random numbers of their loss."""

    windows: FingerBatch
    noise: FingerNoise


class FingerTask(TrainingTask[NoisyFingerBatch]):
    """A finger model and the clips with moving fingers that it is trained on."""

    kind = "fingers"
    config: FingerTraining

    def __init__(
        self,
        config: FingerConfig,
        training: FingerTraining,
        clips: Sequence[FingerClip],
        recorded: Sequence[FingerClip] = (),
        *,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError if no clip has moving fingers."""
        with seeded(training.seed):
            self.model = FingerModel(config)
        super().__init__(training, {"model": self.model}, card)
        groups = [[clip for clip in group if clip.is_moving.any()] for group in (clips, recorded)]
        shares = [1 - training.recorded if groups[1] else 1.0, training.recorded]
        pairs = [(group, share) for group, share in zip(groups, shares, strict=True) if group]
        if not pairs:
            raise MotionError("no clip has fingers that move; give clips with good fingers")
        groups, shares = [group for group, _ in pairs], [share for _, share in pairs]
        _measure(self.model, groups)
        self.sampler = FingerSampler(self.model, groups, shares, seed=training.seed)

    def draw(self, step: int) -> NoisyFingerBatch:
        """See `TrainingTask.draw`; windows are normalised by the model's fixed statistics."""
        windows = self.sampler.batch(step, self.config.batch)
        return NoisyFingerBatch(windows, draw_noise(windows, self.config.noise(step, _NOISE * self.config.seed)))

    def weight(self, batch: NoisyFingerBatch) -> float:
        """Number of hands in the loss."""
        return count_learned_hands(batch.windows, self.config, batch.noise)

    def loss(self, batch: NoisyFingerBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        return Loss(denoising_loss(self.model, batch.windows, self.config, batch.noise), {})

    def save(self, folder: Path, step: int) -> None:
        """The finger model, in half precision."""
        self.model.save(folder, self.card(step), dtype=torch.float16)


def _measure(model: FingerModel, groups: Sequence[Sequence[FingerClip]]) -> None:
    """Set the model's statistics; every group counts equally, whatever its length."""
    moving = [torch.cat([clip.hands[:, clip.is_moving].flatten(0, 1) for clip in group]) for group in groups]
    bodies = [torch.cat([clip.body for clip in group]) for group in groups]
    hands, body = torch.cat(_equal_length(moving)), torch.cat(_equal_length(bodies))
    body = torch.cat([body, mirror_body(body)])
    pairs = zip(model.basis, fit_basis(hands, model.config.poses), strict=True)
    for own, value in (*pairs, (model.body_mean, body.mean(0)), (model.body_std, body.std(0))):
        own.copy_(value)


def _equal_length(groups: Sequence[Tensor]) -> list[Tensor]:
    """Resample all groups to the same number of rows: that of the longest, at most 20,000."""
    count = min(20_000, max(len(rows) for rows in groups))
    return [rows[torch.linspace(0, len(rows) - 1, count).long()] for rows in groups]
