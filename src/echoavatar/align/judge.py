"""From codes to rewards: decode the motion, then call the reward functions."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int
from torch import Tensor

from ..tokenizer import BodyTokenizer
from .prompts import Prompt
from .rewards import RewardMix, Rewards
from .scene import Scene, decode_scenes

PIECE = 64  # continuations decoded at a time
Judge = Callable[[Sequence[Prompt], Int[Tensor, "r n p q"]], Rewards]
"""Rewards of continuations; the rows of one prompt follow each other."""


class SceneJudge:
    """Decodes continuations with the bundle's tokenizer and judges the motion."""

    def __init__(self, tokenizer: BodyTokenizer, mix: RewardMix) -> None:
        self.tokenizer, self.mix = tokenizer, mix

    def __call__(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> Rewards:
        """Rewards of continuations."""
        group = len(codes) // len(prompts)
        each = max(1, PIECE // group)
        found = []
        for start in range(0, len(prompts), each):
            some = prompts[start : start + each]
            rows = slice(start * group, (start + len(some)) * group)
            found.append(self.mix(self.scenes(some, codes[rows])))
        return joined(found)

    def scenes(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> list[Scene]:
        """The continuations as motion."""
        return decode_scenes(self.tokenizer, prompts, codes)


def joined(found: Sequence[Rewards]) -> Rewards:
    """Concatenate the rewards of several batches."""
    parts = {name: np.concatenate([one.parts[name] for one in found]) for name in found[0].parts}
    tokens, whole = (np.concatenate([getattr(one, field) for one in found]) for field in ("tokens", "whole"))
    return Rewards(tokens, whole, parts)
