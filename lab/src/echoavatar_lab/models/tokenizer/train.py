"""Tokenizer training: 64-frame windows, AdamW with step decay (paper, appendix Motion Tokenizer Training Details).

The three parts train together, one window of the whole body a row. Everything is float32: the networks are small and
run on CPUs, few of which are faster in bfloat16. The codebooks learn after the whole batch has passed, so that
any number of pieces and processes gives one result; only the loss of planted feet is a mean within a piece. Windows are
cut anywhere from the corpus, half of them mirrored.

A head start for short runs (ours, not the paper's; `start_from_principal_axes`): the tokenizer begins as a principal
component analysis of single frames. Every residual branch starts at zero, the first layer at the principal axes of the
(normalised) features, the last at their transpose: before the first step the network already returns the mean of each
token's four frames, and training only has to add the motion inside a token.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.models.tokenizer_config import BodyTokenizerConfig, MotionTokenizerConfig
from echoavatar.motion.kinematics import Skeleton, part_sizes, to_features
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.data.feature_statistics import FeatureStatistics, measure_features
from echoavatar_lab.models.codebook_training import LearningQuantizer, Share
from echoavatar_lab.models.tokenizer.model import BodyTokenizer, MotionTokenizer, split_parts
from echoavatar_lab.nn.blocks import CausalBlock, Mlp
from echoavatar_lab.training import Gather, Loss, Schedule, TrainingConfig, TrainingTask, adamw, seeded
from echoavatar_lab.training.task import BatchT

from .losses import LossWeights, MotionLoss, total
from .measure import measure
from .variants import AnyBodyTokenizer

log = logging.getLogger(__name__)


def as_one_part(skeleton: Skeleton) -> Skeleton:
    """The same rig as one part, with which the paper compares its body parts. Features change their order."""
    joints = {"body": tuple(sorted(skeleton.feature_joints))}
    return Skeleton(skeleton.config.model_copy(update={"parts": joints}))


def body_config(skeleton: Skeleton, template: MotionTokenizerConfig) -> BodyTokenizerConfig:
    """The same sizes for every part; `template.features` is replaced."""
    return BodyTokenizerConfig(
        skeleton=skeleton.config,
        parts={name: template.model_copy(update={"features": size}) for name, size in part_sizes(skeleton).items()},
    )


class TokenizerTraining(TrainingConfig):
    """Batch, schedule and losses (paper, appendix Motion Tokenizer Training Details)."""

    steps: int = Field(default=100_000, gt=0, description="optimiser steps")
    batch: int = Field(default=256, gt=0, description="windows per step")
    frames: int = Field(default=64, gt=0, description="frames per window")
    learning_rate: float = Field(default=2e-4, gt=0, description="peak (paper, Settings: 4e-4; the release: 2e-4)")
    schedule: Schedule = Field(default="step", description="course of the learning rate after the warm-up")
    warmup: int = Field(default=200, ge=0, description="steps of linear warm-up")
    temperature: float = Field(default=0.5, ge=0, description="Gumbel noise on the choice of codes")
    dropout: float = Field(default=0.2, ge=0, le=1, description="probability of using only the first RVQ layers")
    quantize_from: int = Field(default=0, ge=0, description="ours: steps before it as a plain auto-encoder")
    is_principal_start: bool = Field(default=False, description="ours: start as a principal component analysis")
    is_scaled_by_reach: bool = Field(default=False, description="ours: weigh joints by what hangs on them")
    is_mirrored: bool = Field(default=True, description="mirror half of the windows")
    evaluate_every: int = Field(default=500, ge=0, description="steps between measurements on test clips")
    log_every: int = Field(default=20, gt=0, description="steps between lines of metrics.jsonl")
    save_every: int = Field(default=0, ge=0, description="steps between checkpoints; 0: by the clock only")
    save_minutes: float = Field(default=3.0, ge=0, description="minutes between checkpoints")
    losses: LossWeights = Field(default=LossWeights(), description="loss weights")


def bundle_training() -> TokenizerTraining:
    """The schedule of the default bundle: minutes on a CPU."""
    return TokenizerTraining(
        steps=6000,
        batch=24,
        learning_rate=1.5e-3,
        warmup=100,
        decay_at=(0.6, 0.8, 0.92),
        decay_factor=0.4,
        temperature=0.0,
        dropout=0.0,
        quantize_from=100,
        is_principal_start=True,
        is_scaled_by_reach=True,
        losses=LossWeights(position=0.05, travel=0.02, planted=0.3, root=0.5, fingers=0.1),
    )


def continued(training: TokenizerTraining) -> TokenizerTraining:
    """The recipe for going on from a trained tokenizer: codes keep roughly their meaning, so the rate is lower."""
    return training.model_copy(
        update={"learning_rate": training.learning_rate * 0.3, "quantize_from": 0, "is_principal_start": False}
    )


ROTATION_FLOOR = 0.03  # about two degrees: quieter rotation features are not blown up to unit spread
BONE_REACH = 0.05  # metres
TRAVEL_FLOOR = (0.002, 0.002, 0.01)  # metres per frame, metres per frame, metres


class MovingBody(Protocol):
    """The part of a clip that tokenizer training uses; `data.Clip` and `data.ClipMotion` both fit."""

    @property
    def rotations(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        """(t, j, 4) quaternions `wxyz`."""

    @property
    def root(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        """(t, 3) metres."""


def clip_features(skeleton: Skeleton, clip: MovingBody) -> Float[Tensor, "t c"]:
    """Motion features of a clip."""
    rotations, root = (np.asarray(part, np.float32) for part in (clip.rotations, clip.root))
    return torch.from_numpy(to_features(skeleton, matrix_from_quaternion(rotations), root))


def whole_features(skeleton: Skeleton, clip: MovingBody) -> Float[Tensor, "t c"]:
    """Motion features of a clip, cut to whole motion tokens."""
    features = clip_features(skeleton, clip)
    return features[: len(features) - len(features) % FRAMES_PER_MOTION_TOKEN]


def reach_statistics(
    skeleton: Skeleton, features: Iterable[Float[Tensor, "_ c"]], *, is_mirrored: bool
) -> FeatureStatistics:
    """Statistics whose spread is a joint's own, divided by the root of how much of the body hangs on the joint.

    Ours: latents and codes then spend their precision on joints whose rotation moves much of the body.
    Reach is the root of the summed squared distances to all joints below, plus five centimetres for the bone itself.
    """
    statistics = floored_statistics(skeleton, features, is_mirrored=is_mirrored)
    joints = list(skeleton.feature_joints)
    reach = joint_reach(skeleton)[joints].repeat_interleave(6)
    std, travel = statistics.std.clone(), travel_slice(skeleton)
    columns = torch.cat([torch.arange(travel.start), torch.arange(travel.stop, len(std))])
    own = std[columns]
    scaled = (own / reach).sqrt()
    start = 0
    for part in skeleton.config.parts.values():
        here = slice(start, start + 6 * len(part))
        level = (own[here] / scaled[here]).mean()
        std[columns[here]] = scaled[here] * level
        start = here.stop
    return FeatureStatistics(statistics.mean, std, statistics.varies)


def joint_reach(skeleton: Skeleton) -> Float[Tensor, " j"]:
    """How far the body hangs on each joint, metres (see `reach_statistics`)."""
    places = torch.from_numpy(skeleton.rest_positions)
    squares = torch.full((skeleton.joints,), BONE_REACH**2)
    for joint in range(skeleton.joints):
        above = skeleton.parents[joint]
        while above >= 0:
            squares[above] += (places[joint] - places[above]).square().sum()
            above = skeleton.parents[above]
    return squares.sqrt()


def floored_statistics(
    skeleton: Skeleton, features: Iterable[Float[Tensor, "_ c"]], *, is_mirrored: bool
) -> FeatureStatistics:
    """Corpus statistics with a floor under the spread.

    Departs from the paper, which divides by the plain spread: there a joint that hardly moves weighs as much as an arm.
    """
    both = ([clip, mirror_features(skeleton, clip)] if is_mirrored else [clip] for clip in features)
    mean, std, varies = measure_features(clip for pair in both for clip in pair)
    floor = torch.full_like(std, ROTATION_FLOOR)
    floor[travel_slice(skeleton)] = torch.tensor(TRAVEL_FLOOR)
    return FeatureStatistics(mean, torch.maximum(std, floor), varies)


class WindowSampler:
    """Draws batches of windows, every frame of the corpus equally likely; all randomness comes from one generator."""

    def __init__(
        self, skeleton: Skeleton, clips: Sequence[Float[Tensor, "_ c"]], *, frames: int, is_mirrored: bool
    ) -> None:
        if frames % FRAMES_PER_MOTION_TOKEN:
            raise ValueError(f"window of {frames} frames is not a multiple of {FRAMES_PER_MOTION_TOKEN}")
        long_enough = [clip for clip in clips if len(clip) >= frames]
        if not long_enough:
            raise MotionError(f"no clip has {frames} frames; make a corpus with longer clips")
        self.skeleton = skeleton
        self.frames = frames
        self.is_mirrored = is_mirrored
        self.features = torch.cat(long_enough)
        lengths = torch.tensor([len(clip) for clip in long_enough])
        ends = lengths.cumsum(0)
        self.starts = torch.cat(
            [torch.arange(int(end - length), int(end) - frames + 1) for end, length in zip(ends, lengths, strict=True)]
        )

    def draw(self, batch: int, generator: torch.Generator) -> Float[Tensor, "b t c"]:
        """A batch of windows, features not normalised."""
        chosen = self.starts[torch.randint(len(self.starts), (batch,), generator=generator)]
        windows = self.features[chosen[:, None] + torch.arange(self.frames)]
        if self.is_mirrored:
            flipped = torch.rand(batch, generator=generator) < 0.5
            windows = torch.where(flipped[:, None, None], mirror_features(self.skeleton, windows), windows)
        return windows


class BodyTask(TrainingTask[BatchT]):
    """What the training of a whole tokenizer and of its decoder alone share: losses, and errors on test clips."""

    patience = 0.0
    """How steady the codes are from which the test clips are decoded."""

    def __init__(
        self,
        tokenizer: BodyTokenizer,
        training: TrainingConfig,
        losses: LossWeights,
        tests: Sequence[MovingBody],
        card: Mapping[str, object] | None,
    ) -> None:
        self.tokenizer, self.terms = tokenizer, MotionLoss(tokenizer.skeleton, losses)
        super().__init__(training, {"tokenizer": tokenizer, "terms": self.terms}, card)
        self._tests = [clip_features(tokenizer.skeleton, clip) for clip in tests]

    def identity(self) -> Mapping[str, Config]:
        """Sizes only: a schedule may be shortened on the way."""
        return {"tokenizer": self.tokenizer.config}

    def compare(self, decoded: Float[Tensor, "b t c"], truth: Float[Tensor, "b t c"]) -> dict[str, Float[Tensor, ""]]:
        """The terms of the loss between normalised features."""
        statistics = self.tokenizer.statistics
        scale = torch.where(statistics.varies, statistics.std, 0.0)
        return self.terms(decoded, truth, mean=statistics.mean, std=scale)  # type: ignore[no-any-return]

    def evaluate(self) -> Mapping[str, object]:
        """Errors on the test clips."""
        return measure(self.tokenizer, self._tests, self.patience)._asdict() if self._tests else {}

    def save(self, folder: Path, step: int) -> None:
        """The whole tokenizer in half precision; at the end with the scores of what was written."""
        card = self.card(step)
        self.tokenizer.save(folder, card)
        if step >= self.config.steps and self._tests:
            scores = measure(AnyBodyTokenizer.load(folder), self._tests, self.patience)
            self.tokenizer.save(folder, card | {"scores": scores._asdict()})
            log.info("test clips: body %.1f mm, hands %.1f mm", scores.mpjpe_body_mm, scores.mpjpe_hands_mm)


SPARE_SCALE = 0.1  # channels that no axis needs start with a small share of their usual weights


@torch.no_grad()
def start_from_principal_axes(tokenizer: MotionTokenizer, normal: Float[Tensor, "n c"]) -> None:
    """Initialise `tokenizer` from normalised features of its part.

    Raises ValueError if it has no short path between its levels, which the axes need.
    """
    if tokenizer.config.blocks != "attention" or tokenizer.config.resampling != "dual":
        raise ValueError("the principal start needs attention blocks and dual-path resampling; turn it off")
    frames = normal.double()
    centred = frames - frames.mean(0)
    _, axes = torch.linalg.eigh(centred.T @ centred / len(frames))  # ascending
    width = tokenizer.config.width
    kept = min(width, normal.shape[1])
    axes = axes.flip(1)[:, :kept].to(tokenizer.input_liner.weight)
    first, last = tokenizer.input_liner, tokenizer.output_liner
    for layer in (first, last):
        layer.weight.mul_(SPARE_SCALE)
        nn.init.zeros_(layer.bias)
    first.weight[:kept] = axes.T
    last.weight[:, :kept] = axes
    for module in tokenizer.modules():
        if isinstance(module, CausalBlock):
            _silence(module.attn.proj)
        elif isinstance(module, Mlp):
            _silence(module.fc2)


def _silence(layer: nn.Linear) -> None:
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)


START_WINDOWS = 400  # windows the principal axes are taken from
START_BATCHES = 12  # how many batches the codebooks are taken from after a start as an auto-encoder
_CODES, _SETTLING, _STARTING = 500_009, 500_029, 500_041  # salts of the other random numbers of a step


def learning_quantizer(config: MotionTokenizerConfig) -> LearningQuantizer:
    """The quantiser of a part while it is trained."""
    names = {"codes", "width", "layers", "decay", "dead_below", "kmeans_steps"}
    return LearningQuantizer(**config.model_dump(include=names))


class Windows(NamedTuple):
    """A batch: features, not normalised, and each window's index in the batch."""

    features: Float[Tensor, "b t c"]
    row: Int[Tensor, " b"]


class TokenizerTask(BodyTask[Windows]):
    """A body tokenizer and its training motion."""

    config: TokenizerTraining

    def __init__(
        self,
        config: BodyTokenizerConfig,
        training: TokenizerTraining,
        clips: Sequence[MovingBody],
        *,
        tests: Sequence[MovingBody] = (),
        card: Mapping[str, object] | None = None,
    ) -> None:
        """Raises MotionError when no clip is as long as a window."""
        with seeded(training.seed):
            tokenizer = AnyBodyTokenizer(config)
        self._quantizers = {name: learning_quantizer(part.config) for name, part in tokenizer.tokenizers().items()}
        for name, part in tokenizer.tokenizers().items():
            part.quantizer = self._quantizers[name]
        super().__init__(tokenizer, training, training.losses, tests, card)
        skeleton = tokenizer.skeleton
        features = [clip_features(skeleton, clip) for clip in clips]
        self.sampler = WindowSampler(skeleton, features, frames=training.frames, is_mirrored=training.is_mirrored)
        statistics = reach_statistics if training.is_scaled_by_reach else floored_statistics
        found = statistics(skeleton, features, is_mirrored=training.is_mirrored)
        for own, value in zip(tokenizer.statistics, found, strict=True):
            own.copy_(value)
        if training.is_principal_start:
            self._start_from_principal_axes()

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW, by which norms decay as well."""
        return [adamw([self.tokenizer], self.config, decays_vectors=True)]

    def draw(self, step: int) -> Windows:
        """See `TrainingTask.draw`."""
        rows = self.config.batch
        return Windows(self.sampler.draw(rows, self.config.noise(step)), torch.arange(rows))

    @torch.no_grad()
    def before(self, batch: Windows, step: int) -> None:
        """Initialise the codebooks: from several batches after a start as an auto-encoder, else from one."""
        if step < self.config.quantize_from or self._is_ready():
            return
        noise = self.config.noise(step, _STARTING)
        draws = START_BATCHES if step else 1
        windows = [self.sampler.draw(self.config.batch, noise) for _ in range(draws - 1)]
        latents: dict[str, list[Tensor]] = {name: [] for name in self.tokenizer.tokenizers()}
        for drawn in (batch.features, *windows):
            normal = self.tokenizer.statistics.normalize(drawn.to(self.tokenizer.mean))
            for name, x in split_parts(self.tokenizer.skeleton, normal).items():
                latents[name].append(self.tokenizer.tokenizers()[name].to_latents(x).flatten(0, 1))
        for name, quantizer in self._quantizers.items():
            quantizer.initialise(torch.cat(latents[name]), noise)

    def loss(self, batch: Windows, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        truth = self.tokenizer.statistics.normalize(batch.features)
        sizes = [part.features for part in self.tokenizer.config.parts.values()]
        noise = torch.Generator(truth.device).manual_seed(self.config.noise(step, _CODES).initial_seed())
        share = Share(int(batch.row[0]), self.config.batch)
        passes = [
            self._pass(name, x, step, noise, share)
            for name, x in zip(self._quantizers, torch.split(truth, sizes, -1), strict=True)
        ]
        terms = self.compare(torch.cat([features for features, _ in passes], -1), truth)
        commitment = torch.stack([commitment for _, commitment in passes]).mean()
        terms["commitment"] = self.config.losses.commitment * commitment
        return Loss(total(terms), terms)

    def after(self, step: int, gather: Gather) -> None:
        """The codebooks learn from the whole batch."""
        noise = self.config.noise(step, _SETTLING)
        for quantizer in self._quantizers.values():
            quantizer.settle(gather, noise)

    def _is_ready(self) -> bool:
        return all(quantizer.is_ready for quantizer in self._quantizers.values())

    def _pass(
        self, name: str, x: Float[Tensor, "b t c"], step: int, noise: torch.Generator, share: Share
    ) -> tuple[Float[Tensor, "b t c"], Float[Tensor, ""]]:
        """A part's normalised features again, through the codes, and the commitment loss."""
        part, config = self.tokenizer.tokenizers()[name], self.config
        latents = part.to_latents(x)
        if step < config.quantize_from:
            return part.from_latents(latents), x.new_zeros(())
        quantized = self._quantizers[name](
            latents, temperature=config.temperature, dropout=config.dropout, generator=noise, share=share
        )
        return part.from_latents(quantized.latents), quantized.commitment

    def _start_from_principal_axes(self) -> None:
        noise = torch.Generator().manual_seed(self.config.seed)
        frames = self.sampler.draw(START_WINDOWS, noise).flatten(0, 1)
        normal = split_parts(self.tokenizer.skeleton, self.tokenizer.statistics.normalize(frames))
        for name, part in self.tokenizer.tokenizers().items():
            start_from_principal_axes(part, normal[name])
