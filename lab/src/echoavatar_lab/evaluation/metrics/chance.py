"""The chance level of a score of audio against motion: each motion scored with the audio of other clips.

Shuffling keeps the statistics of both (how frequent their beats are, how lively they are) and removes only their
correspondence. A score at its chance level means nothing, however high it is.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Score = Callable[[int, int], float]
"""Motion of clip i with the audio of clip j; NaN if the pair cannot be scored."""


def shuffled_scores(
    score: Score, clips: int, *, partners: int | None = None, seed: int = 0
) -> Float[np.ndarray, "n k"]:
    """Score every motion with the audio of other clips: all of them, or `partners` drawn without repetition.

    NaN where a pair cannot be scored; no columns for a single clip, which has no other.
    """
    others = max(clips - 1, 0)
    count = others if partners is None else min(partners, others)
    random = np.random.default_rng(seed)
    scores = np.full((clips, count), np.nan)
    for i in range(clips):
        steps = np.arange(1, clips) if count == others else 1 + random.permutation(others)[:count]
        scores[i] = [score(i, int(j)) for j in (i + steps) % clips]
    return scores


def mean_of_known(scores: Float[np.ndarray, "*n"]) -> float:
    """Mean over the finite values; NaN if there are none."""
    known = scores[np.isfinite(scores)]
    return float(known.mean()) if known.size else float("nan")


def chance_per_clip(scores: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Each motion's chance level: the mean of its row."""
    return np.array([mean_of_known(row) for row in scores])
