"""From codes to rewards: decode the motion, then call the reward functions."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int
from torch import Tensor

from echoavatar.models.tokenizer import BodyTokenizer

from .decoded_motion import DecodedMotion, decode_continuations
from .prompts import Prompt
from .rewards import RewardMix, Rewards

PIECE = 64  # continuations decoded at a time
Judge = Callable[[Sequence[Prompt], Int[Tensor, "r n p q"]], Rewards]
"""Rewards of continuations; the rows of one prompt follow each other."""


class DecodingJudge:
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
            found.append(self.mix(self.motions(some, codes[rows])))
        return concatenated(found)

    def motions(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> list[DecodedMotion]:
        """The continuations as motion."""
        return decode_continuations(self.tokenizer.to(codes.device), prompts, codes)


def concatenated(found: Sequence[Rewards]) -> Rewards:
    """Concatenate the rewards of several batches."""
    parts = {name: np.concatenate([one.parts[name] for one in found]) for name in found[0].parts}
    tokens, whole = (np.concatenate([getattr(one, field) for one in found]) for field in ("tokens", "whole"))
    return Rewards(tokens, whole, parts)
