"""Who judges what, in which order and on which side: balanced incomplete blocks.

A rater sees only some of the trials (a block). Blocks are filled one by one with the trial that was used least so far;
among those the one that shares the fewest groups (systems, sounds) with what the block has, and the fewest blocks
with its trials. So any two trials are judged equally often up to one, whatever the numbers are. Then blocks exchange
trials as long as any two trials meet in more equally many blocks, which ends at a balanced incomplete block design
where there is one for such numbers and it is small. Sides and playing order are balanced too.
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
        found.append(block)
    _exchange(found, groups, together, random)
    return [[int(trial) for trial in random.permutation(block)] for block in found]


def _exchange(
    found: list[list[int]],
    groups: Sequence[Sequence[str]],
    together: Int[np.ndarray, "n n"],
    random: np.random.Generator,
) -> None:
    """Two trials of two blocks change places, again and again, unless the design would be worse for it.

    Worse is: more that is alike (same system, same sound) within blocks, or else pairs of trials that meet less evenly
    (sum of squares of `together`). Changes that make it neither better nor worse lead out of dead ends.
    """
    inside = np.zeros((len(found), len(groups)), int)
    for row, block in enumerate(found):
        inside[row, block] = 1
    names = sorted({mark for marks in groups for mark in marks})
    has = np.array([[mark in marks for mark in names] for marks in groups], int).reshape(
        len(groups), len(names)
    )
    alike = has @ has.T
    for _ in range(min(_TRIES, _TRIES_PER_BLOCK * len(found))):
        one, other = random.integers(len(found), size=2)
        gives, takes = (np.flatnonzero(inside[x] > inside[y]) for x, y in ((one, other), (other, one)))
        if not len(gives):
            continue
        a, b = random.choice(gives), random.choice(takes)
        change = inside[other] - inside[one]  # of what `a` meets; `b` meets the opposite
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
