"""From best-and-worst answers to pairs for DPO (paper, Direct Preference Alignment).

Several raters judge the same candidates. The pair is the candidate with the highest score (times best less times
worst) and the one with the lowest. Every answer speaks for the pair (it has the one as best, or the other as worst),
against it (the other way round), both or not at all; a skip says there is no clear difference. "Pairs lacking a
distinct quality disparity are filtered out": too few answers, too little agreement, too small a margin.
"""

from collections.abc import Sequence
from typing import NamedTuple

from .settings import Keeping

Vote = tuple[int, int] | None  # best and worst; None: skipped


class Verdict(NamedTuple):
    """What the raters say of one prompt's candidates."""

    votes: int
    skips: int
    chosen: int | None
    rejected: int | None
    agreement: float  # answers for, of those that speak about the pair
    margin: float  # answers for less those against, as a share of all
    is_kept: bool


def verdict(votes: Sequence[Vote], candidates: int, keep: Keeping) -> Verdict:
    """The pair of one prompt; with a tie for best or worst there is none."""
    said = [vote for vote in votes if vote is not None]
    scores = [sum((best == at) - (worst == at) for best, worst in said) for at in range(candidates)]
    skips = len(votes) - len(said)
    highest, lowest = max(scores), min(scores)
    if not said or scores.count(highest) > 1 or scores.count(lowest) > 1:
        return Verdict(len(votes), skips, None, None, 0.0, 0.0, is_kept=False)
    chosen, rejected = scores.index(highest), scores.index(lowest)
    signs = [_sign(vote, chosen, rejected) for vote in said]
    ahead, against = signs.count(1), signs.count(-1)
    agreement = ahead / (ahead + against) if ahead + against else 0.0
    margin = (ahead - against) / len(votes)
    is_kept = len(votes) >= keep.votes and agreement >= keep.agreement and margin >= keep.margin
    return Verdict(len(votes), skips, chosen, rejected, agreement, margin, is_kept)


def _sign(vote: tuple[int, int], chosen: int, rejected: int) -> int:
    best, worst = vote
    support = (best == chosen) + (worst == rejected) - (best == rejected) - (worst == chosen)
    return (support > 0) - (support < 0)
