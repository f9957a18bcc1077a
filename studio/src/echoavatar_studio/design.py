"""The design of a study in balanced incomplete blocks: who judges which trials, in which order, on which side.

A rater sees only some of the trials (a block). Blocks are filled one by one with the least used trial; ties go to the
trial that shares the fewest groups (systems, sounds) with the block, then to the one that shares the fewest blocks
with its trials. So the uses of any two trials differ by at most one, whatever the numbers. Then blocks exchange
trials as long as this evens out how often two trials share a block. For small numbers this ends at a balanced
incomplete block design if there is one. Sides and playing order are balanced, too.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

_TRIES, _TRIES_PER_BLOCK = 20_000, 120


class Shown(NamedTuple):
    """A trial in a block."""

    trial: int
    order: tuple[int, ...]  # order[slot]: place of the clip shown there
    first: int  # sequential: the slot that plays first


def blocks(groups: Sequence[Sequence[str]], *, count: int, size: int, seed: int) -> list[list[int]]:
    """`count` blocks of `size` different trials each; `groups` are the marks of every trial: its systems and its sound.

    The uses of any two trials differ by at most one.
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
        found.append(block)
    _exchange(found, groups, together, random)
    return [[int(trial) for trial in random.permutation(block)] for block in found]


def _exchange(
    found: list[list[int]],
    groups: Sequence[Sequence[str]],
    together: Int[np.ndarray, "n n"],
    random: np.random.Generator,
) -> None:
    """Swap two trials of two blocks, again and again, unless the swap makes the design worse.

    A design is worse if blocks repeat more systems or sounds, or else if pairs of trials meet less evenly (sum of
    squares of `together`). Swaps that make it neither better nor worse lead out of dead ends.
    """
    inside = np.zeros((len(found), len(groups)), int)
    for row, block in enumerate(found):
        inside[row, block] = 1
    names = sorted({mark for marks in groups for mark in marks})
    has = np.array([[mark in marks for mark in names] for marks in groups], int).reshape(len(groups), len(names))
    alike = has @ has.T
    for _ in range(min(_TRIES, _TRIES_PER_BLOCK * len(found))):
        one, other = random.integers(len(found), size=2)
        gives, takes = (np.flatnonzero(inside[x] > inside[y]) for x, y in ((one, other), (other, one)))
        if not len(gives):
            continue
        a, b = random.choice(gives), random.choice(takes)
        change = inside[other] - inside[one]  # for the trials that `a` meets; the opposite for `b`
        change[[a, b]] = 0
        costs = change @ (alike[a] - alike[b]), change @ (together[a] - together[b]) + change @ change
        if costs > (0, 0):
            continue
        for trial, sign in ((a, 1), (b, -1)):
            together[trial] += sign * change
            together[:, trial] += sign * change
        inside[one, [a, b]], inside[other, [a, b]] = (0, 1), (1, 0)
        found[one][found[one].index(a)], found[other][found[other].index(b)] = int(b), int(a)


class Sides:
    """Gives each showing of a trial its order: the rarest so far for the trial, then for the rater, then at random."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng([seed, 2])
        self._of_trial: dict[int, Counter[tuple[int, int]]] = defaultdict(Counter)
        self._left: dict[int, Counter[int]] = defaultdict(Counter)

    def pair(self, trial: int, rater: int) -> Shown:
        """The order of two clips: which is on side 0, and which plays first. All four ways are balanced."""
        ways = [(flip, first) for flip in (0, 1) for first in (0, 1)]
        counts, left = self._of_trial[trial], self._left[rater]
        totals = Counter({flip: counts[flip, 0] + counts[flip, 1] for flip in (0, 1)})
        flip, first = min(ways, key=lambda way: (totals[way[0]], counts[way], left[way[0]], self._random.random()))
        counts[flip, first] += 1
        left[flip] += 1
        return Shown(trial, (flip, 1 - flip), first)

    def many(self, trial: int, clips: int) -> Shown:
        """The order of a grid of candidates: random, so each clip is in each place equally often in the long run."""
        return Shown(trial, tuple(int(place) for place in self._random.permutation(clips)), 0)


def spread(real: Sequence[int], extra: Sequence[int], seed: Sequence[int]) -> list[int]:
    """Mix the extra trials (checks) into the real ones at unpredictable places, never first."""
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
