"""Bradley-Terry: by hand, against another implementation, and intervals that hold what they promise."""

import choix
import numpy as np
import pytest

from echoavatar_studio.bradley_terry import strengths, wins_of


def test_two_systems_by_hand():
    """Three wins to one: odds 3, so the strengths differ by log 3; the curvature is 4 * 3/4 * 1/4 = 3/4.

    The difference has variance 4/3, each centred strength a quarter of it: half = 1.96 * sqrt(1/3).
    """
    fitted = strengths(np.array([[0, 3.0], [1, 0]]), penalty=1e-9)
    assert fitted.values == pytest.approx([np.log(3) / 2, -np.log(3) / 2], abs=1e-6)
    assert fitted.halves == pytest.approx([1.959964 * np.sqrt(1 / 3)] * 2, rel=1e-4)


def test_ratings_become_wins():
    """Strength of preference does not count, no difference is half a win for either."""
    wins = wins_of(3, [(0, 1, 2), (0, 1, -1), (1, 2, 0)])
    assert wins.tolist() == [[0, 1, 0], [1, 0, 0.5], [0, 0.5, 0]]


@pytest.mark.parametrize("seed", range(3))
def test_another_implementation_says_the_same(seed):
    random = np.random.default_rng(seed)
    true = random.normal(size=5)
    games = []
    for _ in range(200):
        one, other = random.choice(5, 2, replace=False)
        is_first = random.random() < 1 / (1 + np.exp(true[other] - true[one]))
        games.append((one, other) if is_first else (other, one))
    wins = wins_of(5, [(winner, loser, 1) for winner, loser in games])
    theirs = choix.opt_pairwise(5, games, alpha=0.01, method="Newton-CG", tol=1e-10)
    assert strengths(wins, penalty=0.01).values == pytest.approx(theirs - theirs.mean(), abs=1e-4)


def test_a_system_that_always_wins_has_a_finite_strength():
    fitted = strengths(np.array([[0, 20.0], [0, 0]]))
    assert np.isfinite(fitted.values).all()
    assert fitted.values[0] > 2


def test_intervals_hold_the_true_strength_about_95_times_in_100():
    true, random, held = np.array([0.6, 0.0, -0.6]), np.random.default_rng(0), 0
    for _ in range(200):
        wins = np.zeros((3, 3))
        for one, other in ((0, 1), (0, 2), (1, 2)):
            wins[one, other] = random.binomial(60, 1 / (1 + np.exp(true[other] - true[one])))
            wins[other, one] = 60 - wins[one, other]
        fitted = strengths(wins, penalty=1e-6)
        held += int((np.abs(fitted.values - true) <= fitted.halves).sum())
    assert 0.92 < held / 600 < 0.98
