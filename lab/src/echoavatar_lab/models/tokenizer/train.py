"""Tokenizer training: 64-frame windows, AdamW with step decay (paper, appendix Motion Tokenizer Training Details).

The three parts train together, one window of the whole body a row. Everything is float32: the networks are small and
run on CPUs, few of which are faster in bfloat16. The codebooks learn after the whole batch has passed, so that
any number of pieces and processes gives one result; only the loss of planted feet is a mean within a piece.
"""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar import checkpoint
from echoavatar.config import Config
from echoavatar.models.quantize import Share
from echoavatar.models.tokenizer import BodyTokenizer, BodyTokenizerConfig, MotionTokenizer, TokenizerPass
from echoavatar.motion.kinematics import split_parts
from echoavatar_lab.training import Gather, Loss, Progress, TrainingTask, adamw, has_state, train

from .losses import MotionLoss, total
from .measure import measure
from .recipe import TokenizerTraining
from .start import start_from_principal_axes
from .windows import MovingBody, WindowSampler, clip_features, floored_statistics, reach_statistics

START_WINDOWS = 400  # windows the principal axes are taken from
START_BATCHES = 12  # how many batches the codebooks are taken from after a start as an auto-encoder
_CODES, _SETTLING, _STARTING = 500_009, 500_029, 500_041  # salts: what else is random in a step
log = logging.getLogger(__name__)


class Windows(NamedTuple):
    """A batch: features, not normalised, and each window's index in the batch."""

    features: Float[Tensor, "b t c"]
    row: Int[Tensor, " b"]


class TokenizerTask(TrainingTask[Windows]):
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
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            self.tokenizer = BodyTokenizer(config)
        skeleton = self.tokenizer.skeleton
        features = [clip_features(skeleton, clip) for clip in clips]
        self.sampler = WindowSampler(skeleton, features, frames=training.frames, is_mirrored=training.is_mirrored)
        statistics = reach_statistics if training.is_scaled_by_reach else floored_statistics
        self.tokenizer.set_statistics(statistics(skeleton, features, is_mirrored=training.is_mirrored))
        self.terms = MotionLoss(skeleton, training.losses)
        super().__init__(training, {"tokenizer": self.tokenizer, "terms": self.terms})
        if training.is_principal_start:
            self._start_from_principal_axes()
        self._tests = [clip_features(skeleton, clip) for clip in tests]
        self._card = dict(card or {})

    def identity(self) -> Mapping[str, Config]:
        """Sizes only: a schedule may be shortened on the way."""
        return {"tokenizer": self.tokenizer.config}

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
        for name, part in self.tokenizer.tokenizers().items():
            part.quantizer.initialise(torch.cat(latents[name]), noise)

    def loss(self, batch: Windows, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        tokenizer, statistics = self.tokenizer, self.tokenizer.statistics
        truth = statistics.normalize(batch.features)
        sizes = [part.features for part in tokenizer.config.parts.values()]
        noise = torch.Generator(truth.device).manual_seed(self.config.noise(step, _CODES).initial_seed())
        share = Share(int(batch.row[0]), self.config.batch)
        passes = [
            self._pass(part, x, step, noise, share)
            for part, x in zip(tokenizer.tokenizers().values(), torch.split(truth, sizes, -1), strict=True)
        ]
        decoded = torch.cat([result.features for result in passes], -1)
        scale = torch.where(statistics.varies, statistics.std, 0.0)
        terms = self.terms(decoded, truth, mean=statistics.mean, std=scale)
        commitment = torch.stack([result.commitment for result in passes]).mean()
        terms["commitment"] = self.config.losses.commitment * commitment
        return Loss(total(terms), terms)

    def after(self, step: int, gather: Gather) -> None:
        """The codebooks learn from the whole batch."""
        noise = self.config.noise(step, _SETTLING)
        for part in self.tokenizer.tokenizers().values():
            part.quantizer.settle(gather, noise)

    def evaluate(self) -> Mapping[str, object]:
        """Errors on the test clips."""
        return measure(self.tokenizer, self._tests)._asdict() if self._tests else {}

    def save(self, folder: Path, step: int) -> None:
        """The tokenizer in half precision; at the end with the scores of what was written."""
        card: dict[str, object] = {**self._card, "step": step, "training": self.config.model_dump()}
        self.tokenizer.save(folder, card)
        if step >= self.config.steps and self._tests:
            scores = measure(BodyTokenizer.load(folder), self._tests)
            self.tokenizer.save(folder, card | {"scores": scores._asdict()})
            log.info("tokenizer: body %.1f mm, hands %.1f mm", scores.mpjpe_body_mm, scores.mpjpe_hands_mm)

    def _is_ready(self) -> bool:
        return all(part.quantizer.is_ready for part in self.tokenizer.tokenizers().values())

    def _pass(self, part: MotionTokenizer, x: Tensor, step: int, noise: torch.Generator, share: Share) -> TokenizerPass:
        if step < self.config.quantize_from:
            none = torch.full((x.shape[0], 0, part.config.layers), -1)
            return TokenizerPass(part.from_latents(part.to_latents(x)), none, x.new_zeros(()))
        temperature, dropout = self.config.temperature, self.config.dropout
        result: TokenizerPass = part(x, temperature=temperature, dropout=dropout, generator=noise, share=share)
        return result

    def _start_from_principal_axes(self) -> None:
        noise = torch.Generator().manual_seed(self.config.seed)
        frames = self.sampler.draw(START_WINDOWS, noise).flatten(0, 1)
        normal = split_parts(self.tokenizer.skeleton, self.tokenizer.statistics.normalize(frames))
        for name, part in self.tokenizer.tokenizers().items():
            start_from_principal_axes(part, normal[name])


def train_tokenizer(
    config: BodyTokenizerConfig,
    training: TokenizerTraining,
    clips: Sequence[MovingBody],
    tests: Sequence[MovingBody],
    folder: Path,
    *,
    card: Mapping[str, object] | None = None,
    start: BodyTokenizer | None = None,
    minutes: float | None = None,
    device: str = "cpu",
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> BodyTokenizer:
    """Train, or go on where a run stopped, and save the tokenizer in `folder`.

    Args:
        config: sizes and skeleton.
        training: schedule and losses.
        clips: motion to learn.
        tests: motion to measure on.
        folder: receives the checkpoint, `metrics.jsonl` and the training state.
        card: goes into `card.json` beside the scores.
        start: a trained tokenizer of the same sizes whose weights, codebooks and statistics a new run begins with.
        minutes: of this call.
        device: where to compute.
        trackers: where else metrics go.
        progress: called with (step, steps).

    Raises:
        MotionError: no clip is as long as a window.
        CheckpointError: the folder holds a training state of other sizes, or `start` is of other sizes.
    """
    stage = TokenizerTask(config, training, clips, tests=tests, card=card)
    if start is not None and not has_state(folder):
        checkpoint.load_into(stage.tokenizer, start.state_dict(), origin="the tokenizer to start from")
    train(stage, folder, minutes=minutes, device=device, trackers=trackers, progress=progress)
    return stage.tokenizer
