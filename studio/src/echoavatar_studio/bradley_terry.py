"""Bradley-Terry: strengths of systems from paired preferences, with intervals.

P(i over j) = 1 / (1 + exp(s_j - s_i)). The strengths sum to zero and maximise the log-likelihood minus `PENALTY` times
the sum of their squares, which keeps the strength of a system that always wins finite. A rating of no difference counts
as half a win for each. Intervals are normal, from the inverse curvature at the maximum.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

PENALTY = 0.01
_NORMAL_95 = 1.959963984540054


class Strengths(NamedTuple):
    """Log strengths, and the half-widths of their 95 % intervals."""

    values: Float[np.ndarray, " n"]
    halves: Float[np.ndarray, " n"]


def wins_of(count: int, outcomes: Sequence[tuple[int, int, float]]) -> Float[np.ndarray, "n n"]:
    """wins[i, j]: how often i of `count` systems was preferred to j. Outcomes are (i, j, rating towards i)."""
    wins = np.zeros((count, count))
    for one, other, rating in outcomes:
        wins[one, other] += 0.5 + 0.5 * np.sign(rating)
        wins[other, one] += 0.5 - 0.5 * np.sign(rating)
    return wins


def strengths(wins: Float[np.ndarray, "n n"], *, penalty: float = PENALTY) -> Strengths:
    """Strengths by Newton's method; the objective is concave, and a step that would lower it is halved."""
    count, games = len(wins), wins + wins.T
    s = np.zeros(count)

    def objective(s: Float[np.ndarray, " n"]) -> float:
        return float(-(wins * np.logaddexp(0, s[None] - s[:, None])).sum() - penalty * (s**2).sum())

    for _ in range(200):
        likely = 1 / (1 + np.exp(s[None] - s[:, None]))  # i over j
        slope = (wins - games * likely).sum(1) - 2 * penalty * s
        bend = games * likely * (1 - likely)
        curvature = np.diag(bend.sum(1)) - bend + 2 * penalty * np.eye(count)
        step, here = np.linalg.solve(curvature, slope), objective(s)
        while objective(s + step) < here - 1e-12 and np.abs(step).max() > 1e-12:
            step = step / 2
        s = s + step
        if np.abs(step).max() < 1e-10:
            break
    centre = np.eye(count) - 1 / count
    spread = centre @ np.linalg.inv(curvature) @ centre
    return Strengths(s - s.mean(), _NORMAL_95 * np.sqrt(np.maximum(np.diag(spread), 0)))
