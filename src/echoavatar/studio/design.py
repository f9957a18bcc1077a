"""Who judges what, in which order and on which side: balanced incomplete blocks.

A rater sees only some of the trials (a block). Blocks are filled one by one with the trial that was used least so far;
among those the one that shares the fewest groups (systems, sounds) with what the block has, and the fewest blocks
with its trials. So any two trials are judged equally often up to one, whatever the numbers are, and where a balanced
incomplete block design exists for them the greedy choice comes near it. Sides and playing order are balanced the same
way.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np


class Shown(NamedTuple):
    """A trial in a block."""

    trial: int
    order: tuple[int, ...]  # order[slot]: place of the clip shown there
    first: int  # sequential: the slot that plays first


def blocks(groups: Sequence[Sequence[str]], *, count: int, size: int, seed: int) -> list[list[int]]:
    """`count` blocks of `size` different trials each; `groups` are the marks of every trial: its systems, its sound.

    The uses of any two trials differ by one at most.
    """
    random = np.random.default_rng([seed, 1])
    size = min(size, len(groups))
    used, together = np.zeros(len(groups), int), np.zeros((len(groups), len(groups)), int)
    found = []
    for _ in range(count):
        block: list[int] = []
        marks: Counter[str] = Counter()
        for _ in range(size):
            free = [trial for trial in range(len(groups)) if trial not in block]
            best = min(
                free,
                key=lambda trial: (
                    used[trial],
                    sum(marks[mark] for mark in groups[trial]),  # noqa: B023  called at once
                    together[trial, block].sum(),  # noqa: B023
                    random.random(),
                ),
            )
            block.append(best)
            marks.update(groups[best])
            used[best] += 1
        for one, other in combinations(block, 2):
            together[one, other] += 1
            together[other, one] += 1
        found.append([int(trial) for trial in random.permutation(block)])
    return found


class Sides:
    """Gives each showing of a trial its order: rarest so far for the trial, then rarest for the rater, then by lot."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng([seed, 2])
        self._of_trial: dict[int, Counter[tuple[int, int]]] = defaultdict(Counter)
        self._left: dict[int, Counter[int]] = defaultdict(Counter)

    def pair(self, trial: int, rater: int) -> Shown:
        """Two clips: which is clip 0, and which plays first; all four ways equally often up to one."""
        ways = [(flip, first) for flip in (0, 1) for first in (0, 1)]
        counts, left = self._of_trial[trial], self._left[rater]
        totals = Counter({flip: counts[flip, 0] + counts[flip, 1] for flip in (0, 1)})
        flip, first = min(
            ways, key=lambda way: (totals[way[0]], counts[way], left[way[0]], self._random.random())
        )
        counts[flip, first] += 1
        left[flip] += 1
        return Shown(trial, (flip, 1 - flip), first)

    def many(self, trial: int, clips: int) -> Shown:
        """A candidates' grid: by lot, each clip in each place equally often in the long run."""
        return Shown(trial, tuple(int(place) for place in self._random.permutation(clips)), 0)


def spread(real: Sequence[int], extra: Sequence[int], seed: Sequence[int]) -> list[int]:
    """The real trials in their order with the extra ones (checks) among them, never first, not foreseeably."""
    if not extra:
        return list(real)
    random = np.random.default_rng([*seed, 3])
    edges = np.linspace(0, len(real), len(extra) + 1)
    row = list(real)
    cuts = [
        int(random.integers(max(1, int(low)), max(2, int(high) + 1)))
        for low, high in zip(edges, edges[1:], strict=False)
    ]
    for shift, (cut, trial) in enumerate(zip(cuts, extra, strict=True)):
        row.insert(min(cut + shift, len(row)), trial)
    return row
