"""Training of the decoder alone, on the codes that a generator is trained on.

A tokenizer trains its decoder on the nearest codes. A generator learns steadier codes (`quantize.steadiest`), from
which that decoder makes motion that trembles where latents meet. Here encoder and codebooks are frozen, so codes keep
their meaning and generators stay valid; the decoder learns the true motion of steady codes, with larger weights on
velocity and acceleration than in the paper. Not in the paper.
"""

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from echoavatar.errors import MotionError
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.models.codebook_training import steady_codes
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.progress import Progress, watched
from echoavatar_lab.training import Loss, TrainingConfig, adamw

from .losses import LossWeights, total
from .train import BodyTask, MovingBody, whole_features


class DecoderTraining(TrainingConfig):
    """Batch, schedule and losses; the defaults suit the default bundle's tokenizer on a CPU."""

    steps: int = Field(default=3000, gt=0, description="optimiser steps")
    batch: int = Field(default=12, gt=0, description="windows per step")
    tokens: int = Field(default=24, gt=0, description="tokens per window")
    unheard: int = Field(default=4, ge=0, description="first tokens of a window without cost: they lack a past")
    patience: float = Field(default=0.4, ge=0, description="how steady the codes are, as in `train tokens`")
    learning_rate: float = Field(default=6e-4, gt=0, description="peak of the schedule")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    is_mirrored: bool = Field(default=True, description="learn every clip's mirror image too")
    log_every: int = Field(default=20, gt=0, description="steps between lines of metrics.jsonl")
    evaluate_every: int = Field(default=500, ge=0, description="steps between measurements on test clips")
    save_every: int = Field(default=250, ge=0, description="steps between checkpoints")
    losses: LossWeights = Field(
        default=LossWeights(
            position=0.05, velocity=0.6, acceleration=0.8, travel=0.02, planted=0.3, root=0.5, fingers=0.1
        ),
        description="loss weights; the commitment's has no effect",
    )


class Pairs(NamedTuple):
    """Features, not normalised, and their codes."""

    features: Float[Tensor, "b t c"]
    codes: Int[Tensor, "b n p q"]


class DecoderTask(BodyTask[Pairs]):
    """A trained tokenizer whose decoder is trained further."""

    config: DecoderTraining

    def __init__(
        self,
        tokenizer: BodyTokenizer,
        training: DecoderTraining,
        clips: Sequence[MovingBody],
        *,
        tests: Sequence[MovingBody] = (),
        card: Mapping[str, object] | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Encode all clips, whole; `progress` is called with (clip, clips).

        `tokenizer` itself does not change. Raises MotionError when no clip is as long as a window.
        """
        # codes come from this tokenizer, whatever the folder of the run holds
        super().__init__(copy.deepcopy(tokenizer).eval(), training, training.losses, tests, card)
        self.patience = training.patience
        room = [len(clip.rotations) // FRAMES_PER_MOTION_TOKEN - training.tokens + 1 for clip in clips]
        kept = [(clip, size) for clip, size in zip(clips, room, strict=True) if size > 0]
        if not kept:
            raise MotionError(f"no clip has {training.tokens} tokens of motion; use longer clips")
        self._ends = torch.tensor([size for _, size in kept]).cumsum(0)
        self._clips = list[tuple[Tensor, list[Tensor]]]()
        for clip, _ in watched(kept, progress):
            self._clips.append(self._encoded(clip))

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over the decoders; the rest is frozen."""
        for parameter in self.tokenizer.parameters():
            parameter.requires_grad_(False)
        for parameter in self.clipped_parameters():
            parameter.requires_grad_(True)
        return [adamw(self._learning(), self.config)]

    def clipped_parameters(self) -> Iterable[nn.Parameter]:
        """The decoders."""
        return (parameter for module in self._learning() for parameter in module.parameters())

    def draw(self, step: int) -> Pairs:
        """See `TrainingTask.draw`."""
        noise, rows = self.config.noise(step), self.config.batch
        drawn = torch.randint(int(self._ends[-1]), (rows,), generator=noise)
        flips = torch.rand(rows, generator=noise) < (0.5 if self.config.is_mirrored else 0.0)
        windows = [self._window(int(at), bool(flip)) for at, flip in zip(drawn, flips, strict=True)]
        return Pairs(*(torch.stack(part) for part in zip(*windows, strict=True)))

    def loss(self, batch: Pairs, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        skipped = self.config.unheard * FRAMES_PER_MOTION_TOKEN
        truth = self.tokenizer.statistics.normalize(batch.features)
        parts = [part.decode(batch.codes[:, :, p]) for p, part in enumerate(self.tokenizer.tokenizers().values())]
        terms = self.compare(torch.cat(parts, -1)[:, skipped:], truth[:, skipped:])
        return Loss(total(terms), terms)

    def _learning(self) -> list[nn.Module]:
        return [
            module
            for part in self.tokenizer.tokenizers().values()
            for module in (part.decoder, part.up_sample, part.output_liner)
        ]

    def _encoded(self, clip: MovingBody) -> tuple[Tensor, list[Tensor]]:
        """A clip's features, and their codes as a stream would choose them, plain and mirrored."""
        features = whole_features(self.tokenizer.skeleton, clip)
        both = [features]
        if self.config.is_mirrored:
            both.append(mirror_features(self.tokenizer.skeleton, features))
        return features, [steady_codes(self.tokenizer, x[None], self.config.patience)[0].short() for x in both]

    def _window(self, at: int, is_mirrored: bool) -> Pairs:
        clip = int(torch.searchsorted(self._ends, at, right=True))
        first = at - (int(self._ends[clip - 1]) if clip else 0)
        last, each = first + self.config.tokens, FRAMES_PER_MOTION_TOKEN
        features, codes = self._clips[clip]
        cut = features[first * each : last * each]
        if is_mirrored:
            cut = mirror_features(self.tokenizer.skeleton, cut)
        return Pairs(cut, codes[is_mirrored][first:last].long())
