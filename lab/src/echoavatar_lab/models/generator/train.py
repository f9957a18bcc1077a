"""Training on tokenised clips: hierarchical loss scaling, Hierarchical Token Corruption, control by example.

Paper, Audio Driven Motion Generation. Everything random in a step depends on the seed and the step's number, and is
in its batch (see `training`). The three stages of the curriculum are choices of `GeneratorTraining`.

Stage 1 (Embedding Space Alignment) projects audio and motion codes into the model's latent space. `align_embeddings`
does it without training: one fixed random orthogonal map per modality keeps the distances between code vectors. Departs
from the paper, which trains the embeddings with a frozen backbone.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from echoavatar.errors import CheckpointError
from echoavatar.models.generator.config import GeneratorConfig
from echoavatar.models.tokens import Prefix
from echoavatar_lab import checkpoint
from echoavatar_lab.models.generator.exemplar import control_ids, segment_of
from echoavatar_lab.models.generator.model import Body, Generator
from echoavatar_lab.training import Loss, Muon, TrainingConfig, TrainingTask, adamw, seeded

from ..published import init_from_qwen
from .losses import CueReader, code_nll, freeze_body, hierarchical_loss, nll_by_domain, stream_loss, stream_nll, summary
from .sequences import Exemplar, Sequences, build_sequences, read
from .windows import TokenClip, Window, WindowSampler, corrupt_hierarchically, corrupt_uniformly, draw_exemplar


class GeneratorTraining(TrainingConfig):
    """The defaults suit a small model from scratch on a CPU.

    Paper, Audio Driven Motion Generation. Stage 1, Embedding Space Alignment: `objective` "streams". Stage 2,
    Acoustic-Kinematic Alignment: the default. Stage 3, Exemplar-Driven Control: `exemplar` above 0.
    """

    steps: int = Field(default=3000, gt=0, description="optimiser steps of the whole schedule")
    batch: int = Field(default=8, gt=0, description="windows per step")
    chunks: int = Field(
        default=24, gt=0, description="chunks per window; more than window_chunks trains the steady stream"
    )
    objective: Literal["motion", "streams"] = Field(
        default="motion",
        description="motion codes from sound and motion; or (paper, stage 1) the next code of sound alone and of "
        "motion alone, of which the embeddings learn while the body is frozen",
    )
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule (paper: 5e-5, from Qwen)")
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay of matrices")
    betas: tuple[float, float] = Field(default=(0.9, 0.95), description="AdamW's averages")
    optimiser: Literal["adamw", "muon"] = Field(
        default="adamw", description="paper: AdamW; Muon takes the layers' matrices and learns in fewer steps"
    )
    depth_weights: tuple[float, ...] = Field(default=(1.0, 0.7, 0.5, 0.35), description="loss weight of each RVQ layer")
    corruption: Literal["hierarchical", "uniform", "none"] = Field(
        default="hierarchical", description="what is done to the context motion codes"
    )
    corruption_low: float = Field(default=0.0, ge=0, le=1, description="smallest corruption rate of a window")
    corruption_high: float = Field(default=0.5, ge=0, le=1, description="largest; the paper gives no rate")
    blind: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion is all noise: the sound must tell (not in the paper)",
    )
    asked: float = Field(
        default=1.0,
        gt=0,
        le=1,
        description="depth order: share of the frames of a window whose codes are asked for; all are heard and read, "
        "so that the backbone sees more motion in the same time (not in the paper)",
    )
    out_of_step: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion drifts up to 3 tokens early or late (not in the paper)",
    )
    other_past: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows whose context motion is another window's up to a random token, as when the body"
        " still talks while music plays: the sound must tell (not in the paper)",
    )
    exemplar: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of windows that are told a set of their own first-layer upper codes (paper, stage 3)",
    )
    manner: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="depth order: share of windows that are told how their speaker gestures (not in the paper)",
    )
    only: Literal["all", "manner", "heights"] = Field(
        default="all",
        description="learn only what a manner, or the heights of hands, do: a small weight learns slowly beside the "
        "rest",
    )
    cue_weight: float = Field(
        default=0.0,
        ge=0,
        description="weight of telling beats and stresses half-way up, where known (`cues`; not in the paper)",
    )
    short_windows: float = Field(default=0.2, ge=0, le=1, description="prefix: share of windows cut short in front")


def align_embeddings(
    generator: Generator,
    *,
    audio_codebooks: Float[Tensor, "l A a"] | None = None,
    motion_codebooks: Float[Tensor, "p q K c"] | None = None,
) -> None:
    """Set the embeddings of codes to their code vectors, projected orthogonally and scaled to 0.02 per channel.

    Each codebook is centred and brought to unit mean square first; a random vector per codebook tells the layers apart.
    """
    layout, random = generator.config.layout, torch.Generator().manual_seed(0)
    groups: list[tuple[int, Tensor]] = []
    if audio_codebooks is not None:
        groups.append((layout.audio_base, audio_codebooks))
    if motion_codebooks is not None:
        groups.append((layout.motion_base, motion_codebooks.flatten(0, 1)))
    with torch.no_grad():
        for base, books in groups:
            for table in (body.embed_tokens for body in _bodies(generator)):
                rows = _project(books.detach().float().cpu(), table.embedding_dim, random) * 0.02
                table.weight[base : base + rows.shape[0]] = rows.to(table.weight.device)


def _project(books: Float[Tensor, "k K c"], width: int, random: torch.Generator) -> Float[Tensor, "rows width"]:
    books = books - books.mean(dim=1, keepdim=True)
    books = books / books.square().mean(dim=(1, 2), keepdim=True).clamp(min=1e-12).sqrt()
    square = torch.randn(max(width, books.shape[2]), max(width, books.shape[2]), generator=random)
    basis = torch.linalg.qr(square).Q[: books.shape[2], :width]
    spread = books @ basis * (width / basis.square().sum()) ** 0.5
    name = torch.randn(books.shape[0], 1, width, generator=random)
    rows: Tensor = ((spread + name) / 2**0.5).flatten(0, 1)
    return rows


def _bodies(generator: Generator) -> list[Body]:
    """Its transformers."""
    return [generator.model] if generator.depth is None else [generator.model, generator.depth.body]


_FARTHEST, _DRIFT = 3, 0.08  # tokens out of step (0.4 s, half a slow beat); chance of a change at each token
_MEASURED = 512  # windows of an evaluation
_EXEMPLARS, _MANNERS = 500_009, 700_001  # salts of the random numbers of directives and manners


class Lesson(NamedTuple):
    """A batch: windows, and their motion as the generator sees it."""

    window: Window
    context: Int[Tensor, "b n p q"]  # motion codes, corrupted
    missing: Int[Tensor, " b"]  # leading chunks that count as not there
    exemplar: Exemplar | None
    asked: Int[Tensor, "b n"] | None  # the frames whose codes are asked for, the same in all rows; None is all
    manner: Float[Tensor, "b n m"]  # NaN where it is not told


@torch.no_grad()
def initialise(generator: Generator) -> None:
    """Draw weights: normal with 0.02; what writes into the residual path shrinks with depth.

    A backbone's hidden state is normed, so its map into the depth transformer makes it as small as the embedded codes
    that it is added to.
    """
    config = generator.config
    for name, parameter in generator.named_parameters():
        if name.endswith("bias"):
            nn.init.zeros_(parameter)
        elif parameter.dim() > 1:
            into_residual = name.endswith(("o_proj.weight", "down_proj.weight"))
            nn.init.normal_(parameter, std=0.02 / ((2 * config.layers) ** 0.5 if into_residual else 1))
    if generator.depth is not None:
        generator.depth.condition.weight.mul_(config.width**-0.5)
    for control in (generator.exemplar, generator.manner):
        if control is not None:
            control.clear()


class GeneratorTask(TrainingTask[Lesson]):
    """A generator, the clips of split "train" that it learns from, and those of split "test" that measure it."""

    kind = "generator"
    config: GeneratorTraining

    def __init__(
        self,
        config: GeneratorConfig,
        training: GeneratorTraining,
        clips: Sequence[TokenClip],
        *,
        audio_codebooks: Float[Tensor, "l A a"] | None = None,
        motion_codebooks: Float[Tensor, "p q K c"] | None = None,
    ) -> None:
        """Raises CheckpointError when config and training do not fit, MotionError when no clip is long enough."""
        if len(training.depth_weights) != config.layout.motion_layers:
            raise CheckpointError(
                f"depth_weights has {len(training.depth_weights)} values for {config.layout.motion_layers} RVQ layers"
            )
        if training.asked < 1 and config.sequence != "depth":
            raise CheckpointError("training asked < 1 needs a generator of the depth order; leave it at 1")
        if training.exemplar and not config.exemplar:
            raise CheckpointError("training exemplar > 0 needs a generator config with exemplar true")
        if (training.manner or training.only != "all") and not config.manner:
            raise CheckpointError("training manner > 0 needs a generator config with manner true")
        if training.exemplar and config.control == "prompt" and not config.layout.before_example:
            raise CheckpointError(
                "control prompt needs a layout with before_example, behind which control tokens stand"
            )
        with seeded(training.seed):
            self.generator = Generator(config)
            initialise(self.generator)
            self.cues = CueReader(self.generator)
        align_embeddings(self.generator, audio_codebooks=audio_codebooks, motion_codebooks=motion_codebooks)
        is_reading = training.cue_weight > 0 and training.objective == "motion"
        super().__init__(training, {"generator": self.generator} | ({"cues": self.cues} if is_reading else {}))
        if training.objective == "streams":
            freeze_body(self.generator)
        if training.only != "all":
            self.generator.requires_grad_(False)
            assert self.generator.manner is not None
            for name, weight in self.generator.manner.named_parameters():
                weight.requires_grad_(training.only == "manner" or not name.startswith("proj"))
        self.has_idle = self.generator.exemplar is not None and not training.exemplar and training.objective == "motion"
        self.is_recordable = config.sequence == "depth" and training.objective == "motion"
        self.chunks = config.window_chunks if config.sequence == "prefix" else training.chunks
        chosen = [clip.heard_ahead(config.ahead_chunks) for clip in clips if clip.split == "train"]
        self.held_out = [clip for clip in clips if clip.split == "test" and clip.chunks >= self.chunks]
        self.sampler = WindowSampler(chosen, chunks=self.chunks, seed=training.seed)

    def begin_with(self, start: Generator | Path) -> None:
        """Take the weights of a trained generator, which may lack a control, or the body of a Qwen2 folder."""
        if isinstance(start, Path):
            init_from_qwen(self.generator, start)
            return
        own, weights = self.generator.state_dict(), start.state_dict()
        new = [key for key in own if key not in weights and key.startswith(("exemplar.", "manner."))]
        weights = dict(weights) | {key: own[key] for key in new}
        checkpoint.load_into(self.generator, weights, origin="the generator to start from")

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over everything; or Muon over the layers' matrices and AdamW over embeddings, heads, norms, biases."""
        rate, decay = self.config.learning_rate, self.config.weight_decay
        matrices = (p for body in _bodies(self.generator) for p in body.layers.parameters() if p.dim() == 2)
        layers = [matrix for matrix in matrices if matrix.requires_grad]
        inner = layers if self.config.optimiser == "muon" else []
        found: list[torch.optim.Optimizer] = [adamw(self.modules.values(), self.config, but=inner)]
        if inner:  # matched to AdamW's step size, one rate serves both
            found.append(Muon(inner, rate=rate, weight_decay=decay))
        return found

    def clipped_parameters(self) -> Iterable[nn.Parameter]:
        """The generator's parameters; gradients of the cue readers are not clipped."""
        return self.generator.parameters()

    def draw(self, step: int) -> Lesson:
        """Windows of the step; context corrupted, targets clean."""
        training, config = self.config, self.generator.config
        window, random = self.sampler.batch(step, training.batch), training.noise(step)
        rows, context, codebook = training.batch, window.motion, config.layout.motion_codes
        if training.out_of_step:
            context = _out_of_step(context, training.out_of_step, random)
        if training.other_past:
            context = _other_past(context, training.other_past, random)
        low, high = training.corruption_low, training.corruption_high
        rates = low + (high - low) * torch.rand(rows, generator=random)
        if training.corruption == "hierarchical":
            context = corrupt_hierarchically(context, rates, codebook=codebook, generator=random)
        elif training.corruption == "uniform":
            context = corrupt_uniformly(context, rates, codebook=codebook, generator=random)
        if training.blind:
            blind = (torch.rand(rows, generator=random) < training.blind).float()
            context = corrupt_uniformly(context, blind, codebook=codebook, generator=random)
        missing = torch.zeros(rows, dtype=torch.int64)
        if config.sequence == "prefix":
            cut = torch.rand(rows, generator=random) < training.short_windows
            missing = torch.randint(self.chunks, (rows,), generator=random) * cut
        asked = None
        if training.asked < 1:
            frames = context.shape[1]
            count = math.ceil(training.asked * frames)
            asked = torch.randperm(frames, generator=random)[:count].sort().values.repeat(rows, 1)
        return Lesson(window, context, missing, self._exemplar(window, step), asked, self._manner(window, step))

    def weight(self, batch: Lesson) -> float:
        """Chunks that carry loss."""
        return float((self.chunks - batch.missing).sum())

    def loss(self, batch: Lesson, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        training, window = self.config, batch.window
        if training.objective == "streams":
            streams = stream_nll(self.generator, window)
            means = {"nll_audio": streams.audio.mean(), "nll_motion": streams.motion.mean()}
            return Loss(stream_loss(streams, training.depth_weights), means)
        sequences = self._sequences(batch)
        if batch.asked is not None:
            sequences = sequences.asking(batch.asked[0])
        hidden = read(self.generator, sequences, batch.exemplar, batch.manner)
        nll = code_nll(self.generator, sequences, hidden, batch.exemplar, batch.manner)
        codes = hierarchical_loss(nll, sequences, training.depth_weights)
        told = {"codes": codes} | summary(nll.detach(), sequences, window, batch.exemplar)
        if not training.cue_weight:
            return Loss(codes, told)
        cues = self.cues.loss(window.cues, sequences.predictors)
        return Loss(codes + training.cue_weight * cues, told | {"cues": cues})

    def _sequences(self, batch: Lesson) -> Sequences:
        """The windows as ids; directives stand in front as control tokens where the config says so."""
        config, window = self.generator.config, batch.window
        parts = (config.order, window.audio, batch.context, window.motion, batch.missing)
        if not isinstance(config.order, Prefix) or batch.exemplar is None or config.control != "prompt":
            return build_sequences(*parts)
        start = config.layout.segment_start(segment_of(config.layout))
        ids = start + torch.arange(config.layout.motion_codes, device=window.audio.device)
        return build_sequences(*parts, control_ids(batch.exemplar.members, ids))

    def evaluate(self) -> Mapping[str, object]:
        """Mean NLL of the codes of "test" clips after their true past, of all and by domain; {} without such clips."""
        if not self.held_out:
            return {}
        found = nll_by_domain(
            self.generator.eval(), self.held_out, chunks=self.chunks, batch=self.config.batch, most_windows=_MEASURED
        )
        return {"held_out": found.pop("all")} | {f"held_out_{domain}": nll for domain, nll in found.items()}

    def _exemplar(self, window: Window, step: int) -> Exemplar | None:
        """The step's directives, where the generator takes them."""
        if not self.config.exemplar:
            return None
        config = self.generator.config
        return draw_exemplar(
            window.motion,
            self.config.exemplar,
            codes=config.layout.motion_codes,
            whole=config.sequence == "prefix",
            generator=self.config.noise(step, _EXEMPLARS),
        )

    def _manner(self, window: Window, step: int) -> Float[Tensor, "b n m"]:
        """The step's manners. Where none is known, a random one is told, so that it means nothing there."""
        random = self.config.noise(step, _MANNERS)
        any_manner = torch.rand(len(window.manner), 1, window.manner.shape[-1], generator=random)
        told = torch.rand(len(any_manner), 1, 1, generator=random) < self.config.manner
        known = torch.where(window.manner.isnan(), any_manner, window.manner)
        return torch.where(told, known, torch.nan)


def _out_of_step(motion: Int[Tensor, "b n p q"], share: float, random: torch.Generator) -> Int[Tensor, "b n p q"]:
    """A share of the rows runs early or late by up to 3 tokens, now more, now less: only the sound tells the phase."""
    rows, tokens = motion.shape[:2]
    chosen = torch.rand(rows, 1, generator=random) < share
    start = torch.randint(-_FARTHEST, _FARTHEST + 1, (rows, 1), generator=random)
    turns = torch.rand(rows, tokens, generator=random) < _DRIFT
    ahead = torch.randint(2, (rows, tokens), generator=random) * 2 - 1
    late = (start + (turns * ahead).cumsum(1)).clamp(-_FARTHEST, _FARTHEST) * chosen
    source = (torch.arange(tokens) - late).clamp(0, tokens - 1)
    return motion[torch.arange(rows)[:, None], source]


def _other_past(motion: Int[Tensor, "b n p q"], share: float, random: torch.Generator) -> Int[Tensor, "b n p q"]:
    """A share of the rows with the past of another row until a random token, so that the sound outweighs the past."""
    rows, tokens = motion.shape[:2]
    until = torch.randint(1, tokens + 1, (rows,), generator=random)
    is_other = (torch.arange(tokens) < until[:, None]) & (torch.rand(rows, 1, generator=random) < share)
    return torch.where(is_other[..., None, None], motion.roll(1, 0), motion)
