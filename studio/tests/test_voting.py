"""Best and worst votes to pairs, by hand."""

import pytest

from echoavatar_studio.settings import Keeping
from echoavatar_studio.voting import verdict

KEEP = Keeping(votes=2, agreement=0.6, margin=0.3)


def test_agreement_and_margin_by_hand():
    """Scores: candidate 0 has 2, 3 has -2. For (0, 3): for, for, against (3 over 0), one skip: 2/3 and (2 - 1) / 4."""
    told = verdict([(0, 3), (0, 3), (0, 2), None], 4, KEEP)
    assert (told.votes, told.skips, told.chosen, told.rejected) == (4, 1, 0, 3)
    assert (told.agreement, told.margin, told.is_kept) == (1.0, 0.75, True)
    mixed = verdict([(0, 3), (0, 3), (0, 3), (3, 0), None], 4, KEEP)
    assert (mixed.agreement, mixed.margin, mixed.is_kept) == (0.75, 0.4, True)


@pytest.mark.parametrize(
    ("votes", "why"),
    [
        ([(0, 1)], "too few answers"),
        ([(0, 1), (1, 0)], "a tie"),
        ([None, None, None], "nobody saw a difference"),
        ([(0, 1), None, None, None], "too small a margin"),
        ([], "nobody answered"),
    ],
)
def test_pairs_without_a_distinct_difference_are_left_out(votes, why):
    assert not verdict(votes, 3, KEEP).is_kept, why


def test_an_answer_about_other_candidates_is_neither_for_nor_against():
    told = verdict([(0, 3), (1, 2), (0, 3)], 4, KEEP)
    assert (told.chosen, told.rejected, told.agreement) == (0, 3, 1.0)
    assert told.margin == pytest.approx(2 / 3)
