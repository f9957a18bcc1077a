"""Sizes and schedules of training at three scales, for `bench train` and the paper's tables; and what their rows vary.

`tiny` runs every part in minutes and learns nothing. `rehearsal` is as small as can still tell lines apart: minutes of
a core for each line, in our depth order, since the paper's flattened order learns little in that time. `paper` has the
paper's settings (`echoavatar_lab.paper`) and needs the real datasets, published weights and
GPUs. Rewards have the paper's form at every scale. Generators take the paper's curriculum:
stage 1 before every line, stage 2 for the line, stage 3 for the line with exemplars. All rows of a table are trained
alike: no row has a head start (`is_principal_start`), since not every tokenizer of the ablation could take it, and none
has our own loss terms. A row varies a tokenizer or a generator, given as its differences from the scale's.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import methodcaller
from typing import Any, Literal, NamedTuple

from pydantic import Field

from echoavatar.config import Config
from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.tokenizer_config import MotionTokenizerConfig
from echoavatar_lab import paper
from echoavatar_lab.align.audio_encoders import AudioEncoderConfig
from echoavatar_lab.align.audio_reward import AudioMotionConfig
from echoavatar_lab.align.audio_reward_train import AudioRewardTraining
from echoavatar_lab.align.quality import QualityConfig, QualityTraining
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.models.tokenizer.losses import LossWeights
from echoavatar_lab.models.tokenizer.train import TokenizerTraining

ScaleName = Literal["tiny", "rehearsal", "paper"]


class Scale(Config):
    """Corpus, sizes, schedules."""

    name: ScaleName = Field(description="the name on the command line")
    hours: float = Field(ge=0, description="length of the rehearsal corpus that is made; 0: the user gives a corpus")
    clip_seconds: float = Field(default=64.0, gt=0, description="length of the clips of that corpus")
    test_clips: int = Field(gt=0, description="most test clips that are scored")
    seconds: float = Field(gt=0, description="sound over which latencies are measured")
    tokenizer: MotionTokenizerConfig = Field(description="sizes; features are replaced")
    tokenizer_training: TokenizerTraining = Field(description="schedule")
    generator: GeneratorConfig = Field(description="sizes; the vocabulary is replaced")
    generator_training: GeneratorTraining = Field(description="schedule of stage 2; depth weights and window follow")
    stage1: GeneratorTraining = Field(description="schedule of stage 1: embeddings learn, the body is frozen")
    stage3: GeneratorTraining = Field(description="schedule of stage 3: control by example")
    quality: QualityConfig = Field(description="sizes of the quality reward; features are replaced")
    quality_training: QualityTraining = Field(description="its schedule")
    alignment: AudioMotionConfig = Field(description="sizes of the alignment reward; what it hears is replaced")
    alignment_training: AudioRewardTraining = Field(description="its schedule")
    speech_hours: float = Field(ge=0, description="speech of the RL corpus, if the user gives none")
    pieces: int = Field(ge=0, description="its pieces of music")
    pairs: int = Field(gt=0, description="prompts that DPO's pairs are ranked for")
    tuning: dict[str, int] = Field(default={}, description="what differs from the recipe of that name (`align`)")

    @property
    def generator_trainings(self) -> dict[int, GeneratorTraining]:
        """The schedules of generators by stage."""
        return {1: self.stage1, 2: self.generator_training, 3: self.stage3}


UNKNOWN: dict[str, Any] = {
    "audio_encoder": AudioEncoderConfig(),
    "motion_channels": 1,
}  # replaced when the reward is built

TINY = Scale(
    name="tiny",
    hours=48 * 3 / 3600,
    clip_seconds=3.0,
    test_clips=3,
    seconds=2.0,
    tokenizer=MotionTokenizerConfig(
        features=1, width=32, heads=2, layers=2, codes=32, decay=0.9, dead_below=0.05, kmeans_steps=2
    ),
    tokenizer_training=TokenizerTraining(
        steps=30, batch=8, frames=32, learning_rate=2e-3, warmup=5, temperature=0, dropout=0, evaluate_every=0
    ),
    generator=GeneratorConfig(window_chunks=4, width=32, layers=2, mlp=96),
    generator_training=GeneratorTraining(steps=20, batch=4, warmup=2),
    stage1=GeneratorTraining(objective="streams", steps=10, batch=4, learning_rate=2e-4, schedule="constant", warmup=2),
    stage3=GeneratorTraining(steps=10, batch=4, warmup=2, exemplar=0.8),
    quality=QualityConfig(**paper.QUALITY["model"] | {"width": 32, "heads": 4}),
    quality_training=QualityTraining(steps=4),
    alignment=AudioMotionConfig(**paper.ALIGNMENT["model"] | UNKNOWN | {"width": 32, "heads": 4}),
    alignment_training=AudioRewardTraining(steps=4),
    speech_hours=0.01,
    pieces=1,
    pairs=4,
)

REHEARSAL = Scale(
    name="rehearsal",
    hours=1.8,
    clip_seconds=16.0,
    test_clips=24,
    seconds=60.0,
    tokenizer=MotionTokenizerConfig(
        features=1, width=96, heads=4, layers=4, codes=512, decay=0.98, dead_below=0.05, kmeans_steps=8
    ),
    tokenizer_training=TokenizerTraining(
        steps=400,
        batch=24,
        learning_rate=1.5e-3,
        warmup=40,
        decay_at=(0.6, 0.8, 0.92),
        decay_factor=0.4,
        temperature=0,
        dropout=0,
        quantize_from=40,
        evaluate_every=0,
    ),
    generator=GeneratorConfig(
        sequence="depth", window_chunks=15, width=192, layers=6, mlp=576, depth_width=96, depth_layers=3, depth_heads=4
    ),
    generator_training=GeneratorTraining(steps=320, batch=16, optimiser="muon", asked=0.25),
    stage1=GeneratorTraining(
        objective="streams", steps=40, batch=16, learning_rate=2e-4, schedule="constant", weight_decay=0
    ),
    stage3=GeneratorTraining(steps=120, batch=16, optimiser="muon", asked=0.25, exemplar=0.3),
    quality=QualityConfig(**paper.QUALITY["model"] | {"width": 96, "heads": 4}),
    quality_training=QualityTraining(steps=300),
    alignment=AudioMotionConfig(**paper.ALIGNMENT["model"] | UNKNOWN | {"width": 96, "heads": 4}),
    alignment_training=AudioRewardTraining(steps=100, batch=32),
    speech_hours=0.25,
    pieces=10,
    pairs=64,
    tuning={"steps": 30, "evaluate_every": 15, "videos": 0},
)

PAPER = Scale(
    name="paper",
    hours=0,
    test_clips=1_000,
    seconds=60.0,
    tokenizer=MotionTokenizerConfig(features=1, **paper.TOKENIZER["model"]),
    tokenizer_training=TokenizerTraining(**paper.TOKENIZER["training"] | {"evaluate_every": 0}),
    generator=GeneratorConfig(**paper.STAGE_2["model"]),
    generator_training=GeneratorTraining(**paper.STAGE_2["training"]),
    stage1=GeneratorTraining(**paper.STAGE_1["training"]),
    stage3=GeneratorTraining(**paper.STAGE_3["training"]),
    quality=QualityConfig(**paper.QUALITY["model"]),
    quality_training=QualityTraining(**paper.QUALITY["training"]),
    alignment=AudioMotionConfig(**paper.ALIGNMENT["model"] | UNKNOWN),
    alignment_training=AudioRewardTraining(**paper.ALIGNMENT["training"]),
    speech_hours=paper.SPEECH_HOURS,
    pieces=paper.PIECES,
    pairs=2_000,
)

SCALES: dict[str, Scale] = {scale.name: scale for scale in (TINY, REHEARSAL, PAPER)}


@dataclass(frozen=True)
class TokenizerChoice:
    """A tokenizer."""

    name: str  # the name of its folder
    sizes: Mapping[str, object] = field(default_factory=dict)  # fields of `MotionTokenizerConfig` that differ
    losses: LossWeights = LossWeights()  # weights of the training losses; by default the paper's
    is_whole: bool = False  # the whole body is one part


OURS = TokenizerChoice("body-parts")


@dataclass(frozen=True)
class GeneratorChoice:
    """A generator."""

    name: str  # the name of its folder
    tokenizer: TokenizerChoice = OURS  # the tokenizer whose codes it generates
    sizes: Mapping[str, object] = field(default_factory=dict)  # fields of `GeneratorConfig` that differ
    training: Mapping[str, object] = field(default_factory=dict)  # fields of `GeneratorTraining` that differ
    only: Literal["speech", "music"] | None = None  # train only on clips mostly of this sound; None: on all
    after: "GeneratorChoice | None" = None  # the generator that stage 3 goes on from; None: stage 2
    is_first: bool = False  # it is a generator of stage 1

    @property
    def stage(self) -> Literal[1, 2, 3]:
        """The stage of the paper's curriculum that it is trained by."""
        return 1 if self.is_first else 2 if self.after is None else 3

    @property
    def before(self) -> "GeneratorChoice | None":
        """The generator that it goes on from; stage 1 is shared by all of these codes, clips and order of sequence."""
        if self.is_first or self.after is not None:
            return self.after
        words = [self.tokenizer.name, *([str(self.sizes["sequence"])] if "sequence" in self.sizes else [])]
        words += [self.only] if self.only else []
        sizes = {key: value for key, value in self.sizes.items() if key == "sequence"}
        return GeneratorChoice("-".join(words), self.tokenizer, sizes, only=self.only, is_first=True)


class Variant(NamedTuple):
    """A line of a table with one of our generators, and the paper's numbers of it by column."""

    name: str
    paper: Mapping[str, float]
    generator: GeneratorChoice


Part = Callable[[Any], object]
"""Makes one part of an experiment; a module's function, a partial of one, or a `methodcaller`, which can be pickled."""


def generator_waves(choices: Iterable[GeneratorChoice]) -> list[Sequence[Part]]:
    """Four waves: tokenizers and codes; stage 1; motion of the generators of stage 2; of those that go on from them."""
    chosen = list({choice.name: choice for choice in choices}.values())
    tokenizers = {choice.tokenizer.name: choice.tokenizer for choice in chosen}
    firsts = {one.name: one for choice in chosen if (one := choice.before) is not None and one.is_first}
    return [
        [methodcaller("codes", tokenizer) for tokenizer in tokenizers.values()],
        [methodcaller("generator", first) for first in firsts.values()],
        [methodcaller("generated_motions", choice) for choice in chosen if choice.after is None],
        [methodcaller("generated_motions", choice) for choice in chosen if choice.after is not None],
    ]
