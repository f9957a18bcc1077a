"""From codes to rewards: decode, then ask the reward functions."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from torch import Tensor

from ..tokenizer import BodyTokenizer
from .prompts import Prompt
from .rewards import RewardMix, Rewards
from .scene import decode_scenes

PIECE = 64  # continuations decoded at a time


class SceneJudge:
    """Continuations are decoded by the tokenizer that made the codes, and judged."""

    def __init__(self, tokenizer: BodyTokenizer, mix: RewardMix) -> None:
        self._tokenizer, self._mix = tokenizer, mix

    def __call__(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> Rewards:
        """Rewards of continuations."""
        group = len(codes) // len(prompts)
        each = max(1, PIECE // group)
        found = []
        for start in range(0, len(prompts), each):
            some = prompts[start : start + each]
            rows = slice(start * group, (start + len(some)) * group)
            found.append(self._mix(decode_scenes(self._tokenizer, some, codes[rows])))
        return joined(found)


def joined(found: Sequence[Rewards]) -> Rewards:
    """Rewards of several batches as one."""
    parts = {name: np.concatenate([one.parts[name] for one in found]) for name in found[0].parts}
    tokens, whole = (np.concatenate([getattr(one, field) for one in found]) for field in ("tokens", "whole"))
    return Rewards(tokens, whole, parts)
