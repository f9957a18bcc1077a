"""From best-and-worst answers to pairs for DPO (paper, Direct Preference Alignment).

Several raters judge the same candidates. A candidate's score is how often it was best minus how often it was worst; the
pair is the candidate with the highest score and the one with the lowest. An answer counts for the pair if it has the
first as best or the second as worst, against it if the other way round, and may count for both or neither. A skip means
no clear difference. "Pairs lacking a distinct quality disparity are filtered out": those with too few answers, too
little agreement or too small a margin.
"""

from collections.abc import Sequence
from typing import NamedTuple

from .settings import Keeping

Vote = tuple[int, int] | None  # best and worst; None: skipped


class Verdict(NamedTuple):
    """The raters' verdict on the candidates of one prompt."""

    votes: int
    skips: int
    chosen: int | None
    rejected: int | None
    agreement: float  # share of answers for the pair, among those for or against it
    margin: float  # answers for minus answers against, as a share of all
    is_kept: bool


def verdict(votes: Sequence[Vote], candidates: int, keep: Keeping) -> Verdict:
    """The pair of one prompt; a tie for best or worst gives none."""
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
