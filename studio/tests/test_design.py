"""Blocks, sides and checks: balanced, and by lot where they may be."""

from collections import Counter
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar_studio.design import Sides, blocks, spread


@settings(deadline=None, max_examples=30)
@given(trials=st.integers(1, 20), count=st.integers(1, 15), size=st.integers(1, 25), seed=st.integers(0, 99))
def test_trials_are_used_equally_often_up_to_one_and_never_twice_in_a_block(trials, count, size, seed):
    found = blocks([[f"sound {k}"] for k in range(trials)], count=count, size=size, seed=seed)
    uses = Counter(trial for block in found for trial in block)
    assert all(len(set(block)) == len(block) == min(size, trials) for block in found)
    assert max(uses.values()) - min(uses.get(k, 0) for k in range(trials)) <= 1


@pytest.mark.parametrize(("trials", "count", "size"), [(7, 7, 3), (9, 12, 3), (6, 10, 3)])
@pytest.mark.parametrize("seed", range(3))
def test_balanced_incomplete_blocks_are_found(trials, count, size, seed):
    """Any two trials meet in equally many blocks: the Fano plane, the affine plane of order 3, a 2-(6, 3, 2) design."""
    found = blocks([[] for _ in range(trials)], count=count, size=size, seed=seed)
    together = Counter(pair for block in found for pair in combinations(sorted(block), 2))
    times = count * size * (size - 1) // (trials * (trials - 1))
    assert together == dict.fromkeys(combinations(range(trials), 2), times)


def test_where_there_is_no_such_design_pairs_differ_by_little():
    """20 blocks of 6 out of 12: 300 meetings over 66 pairs, so 4 or 5 each."""
    found = blocks([[] for _ in range(12)], count=20, size=6, seed=0)
    together = Counter(pair for block in found for pair in combinations(sorted(block), 2))
    assert set(together.values()) == {4, 5}


def test_systems_and_sounds_alternate_within_a_block():
    pairs = [("A", "B"), ("A", "C"), ("B", "C")]
    groups = [[f"sound {s}", f"pair {p}", *p] for s in range(4) for p in pairs]
    for block in blocks(groups, count=12, size=6, seed=3):
        shown = Counter(groups[trial][1] for trial in block)
        assert max(shown.values()) - min(shown.get(f"pair {p}", 0) for p in pairs) <= 1


def test_sides_and_playing_order_are_balanced_for_trial_and_rater():
    sides = Sides(0)
    shown = {rater: [sides.pair(trial, rater) for trial in range(8)] for rater in range(12)}
    for trial in range(8):
        ways = Counter((row[trial].order, row[trial].first) for row in shown.values())
        assert set(ways.values()) == {3}  # 12 raters, four ways
    for row in shown.values():
        assert abs(sum(one.order == (0, 1) for one in row) - 4) <= 2


def test_another_seed_is_another_design_and_the_same_seed_the_same():
    groups = [[str(k)] for k in range(10)]
    assert blocks(groups, count=5, size=4, seed=1) == blocks(groups, count=5, size=4, seed=1)
    assert blocks(groups, count=5, size=4, seed=1) != blocks(groups, count=5, size=4, seed=2)


def test_a_grid_is_a_permutation():
    assert sorted(Sides(0).many(0, 8).order) == list(range(8))


@pytest.mark.parametrize("seed", range(20))
def test_checks_are_never_first_and_all_there(seed):
    row = spread([1, 2, 3, 4, 5, 6], [91, 92], [seed])
    assert row[0] not in (91, 92)
    assert sorted(row) == [1, 2, 3, 4, 5, 6, 91, 92]
    assert [one for one in row if one < 90] == [1, 2, 3, 4, 5, 6]
