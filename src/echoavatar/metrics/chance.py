"""The chance level of a score of sound against motion: each motion with the sound of other clips.

Motion and sound keep their own statistics (how often both beat, how lively they are), only their belonging together
is undone. A score at its chance level says nothing, however high it is.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Score = Callable[
    [int, int], float
]  # motion of clip i with the sound of clip j; NaN where it cannot be scored


def shuffled_scores(
    score: Score, clips: int, *, partners: int | None = None, seed: int = 0
) -> Float[np.ndarray, "n k"]:
    """Score of every motion with others' sound: all of them, or `partners` drawn without repetition.

    NaN stays where a pair cannot be scored; no columns for a single clip, which has no other.
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
    """Mean over what is not NaN; NaN where nothing is known."""
    known = scores[np.isfinite(scores)]
    return float(known.mean()) if known.size else float("nan")


def chance_per_clip(scores: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Each motion's own chance level: the mean of its row."""
    return np.array([mean_of_known(row) for row in scores])
