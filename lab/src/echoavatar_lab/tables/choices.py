"""What the rows of a table vary: a tokenizer or a generator, given as its differences from the scale's."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from echoavatar_lab.models.tokenizer.losses import LossWeights


@dataclass(frozen=True)
class TokenizerChoice:
    """A tokenizer.

    Attributes:
        name: the name of its folder.
        sizes: fields of `MotionTokenizerConfig` that differ.
        losses: weights of the training losses; by default the paper's.
        is_whole: the whole body is one part.
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
        name: the name of its folder.
        tokenizer: the tokenizer whose codes it generates.
        sizes: fields of `GeneratorSizes` that differ.
        training: fields of `GeneratorTraining` that differ.
        only: train only on clips that are mostly this kind of sound; None: on all clips.
        after: the generator that stage 3 goes on from; None: stages 1 and 2.
    """

    name: str
    tokenizer: TokenizerChoice = OURS
    sizes: Mapping[str, object] = field(default_factory=dict)
    training: Mapping[str, object] = field(default_factory=dict)
    only: Literal["speech", "music"] | None = None
    after: "GeneratorChoice | None" = None

    @property
    def first_stage(self) -> "GeneratorChoice":
        """The generator of stage 1, which all choices of these codes, clips and order of the sequence begin with."""
        words = [self.tokenizer.name, *([str(self.sizes["sequence"])] if "sequence" in self.sizes else [])]
        words += [self.only] if self.only else []
        sizes = {key: value for key, value in self.sizes.items() if key == "sequence"}
        return GeneratorChoice("-".join(words), self.tokenizer, sizes, only=self.only)
