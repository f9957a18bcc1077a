"""What rows differ in: a tokenizer or a generator, said by how it departs from that of the scale."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from echoavatar.tokenizer import LossWeights


@dataclass(frozen=True)
class TokenizerChoice:
    """A tokenizer.

    Attributes:
        name: of its folder.
        sizes: fields of `MotionTokenizerConfig` that differ.
        losses: weights of the training losses; the paper's unless said.
        is_whole: one part for the whole body.
    """

    name: str
    sizes: Mapping[str, object] = field(default_factory=dict)
    losses: LossWeights = LossWeights()
    is_whole: bool = False


OURS = TokenizerChoice("body-parts")


@dataclass(frozen=True)
class GeneratorChoice:
    """A generator.

    Attributes:
        name: of its folder.
        tokenizer: whose codes it speaks.
        sizes: fields of `GeneratorSizes` that differ.
        training: fields of `GeneratorTraining` that differ.
        only: train on clips of mostly this sound alone; None: on all.
    """

    name: str
    tokenizer: TokenizerChoice = OURS
    sizes: Mapping[str, object] = field(default_factory=dict)
    training: Mapping[str, object] = field(default_factory=dict)
    only: Literal["speech", "music"] | None = None
