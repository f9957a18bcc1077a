"""Raters with known preferences: the study finds them again, within its own intervals; the table is the paper's."""

import numpy as np
import pytest
from studio.tests import canned

from echoavatar_studio.export import export
from echoavatar_studio.making import Maker
from echoavatar_studio.owner_actions import OwnerActions
from echoavatar_studio.quality import rater_rows
from echoavatar_studio.results import results
from echoavatar_studio.simulate import Preferences, simulate

WORTH = {"Alpha": 0.6, "Beta": 0.0, "Gamma": -0.4}
NOISE = 0.6


def expected(gap: float) -> float:
    """Mean of a rounded and cut normal rating, by integration over a fine grid."""
    grid = np.linspace(-6, 6, 24_001)
    weight = np.exp(-0.5 * (grid / NOISE) ** 2)
    return float((np.clip(np.rint(gap + grid), -2, 2) * weight).sum() / weight.sum())


@pytest.mark.slow
def test_known_preferences_are_recovered_within_the_interval(maker: Maker, library):
    study = canned.make_pairwise(maker, library, raters=20, tasks_per_rater=12)
    preferences = Preferences(worth=WORTH, noise=NOISE, of_question={"beat_matching": 0.5})
    simulate(maker.store, OwnerActions(maker, "test"), study, preferences, raters=20, seed=1)
    found = results(maker.store, study)
    assert found.judgements == 240
    held = total = 0
    for row in found.pairs:
        for question, score in row.scores.items():
            gap = (WORTH[row.first] - WORTH[row.second]) * (0.5 if question == "beat_matching" else 1.0)
            held += abs(score.mean - expected(gap)) <= score.half
            total += 1
    assert total == 18
    assert held >= 15  # of 18 intervals at 95 %, fewer than 15 hold once in a thousand times
    for row in found.rows:
        others = [name for name in WORTH if name != row.system]
        truth = np.mean([expected(WORTH[row.system] - WORTH[name]) for name in others])
        score = row.scores["overall_preference"]
        assert abs(score.mean - truth) <= 1.5 * score.half
    overall = [row for row in found.ranking if row.question == "overall_preference" and row.category == "all"]
    assert [row.system for row in overall] == ["Alpha", "Beta", "Gamma"]
    assert overall[0].low > overall[1].strength > overall[2].high
    alphas = {row.question: row.alpha or 0 for row in found.agreement}
    # squared gaps 0.36, 1, 0.16 against a variance of 0.36 and a twelfth for rounding: 1 - 0.44 / (0.51 + 0.44)
    assert 0.35 < alphas["overall_preference"] < 0.7
    assert 0 < alphas["beat_matching"] < alphas["overall_preference"]  # half the gap, the same noise
    table = export(maker.store, maker.media, study, "table.tex").decode()
    alpha = next(line for line in table.splitlines() if " Alpha " in line)
    dance = next(row for row in found.rows if row.system == "Alpha" and row.category == "dance").scores
    assert rf"${dance['human_likeness'].mean:.3f} \pm {dance['human_likeness'].half:.3f}$" in alpha


@pytest.mark.slow
def test_careless_raters_fail_checks_and_leave_the_results_when_excluded(maker: Maker, library):
    shape = {"raters": 12, "tasks_per_rater": 12, "checks": {"identical": 3, "corrupted": 3}}
    study = canned.make_pairwise(maker, library, **shape)
    actions = OwnerActions(maker, "test")
    simulate(maker.store, actions, study, Preferences(worth=WORTH, noise=0.4), raters=6, seed=1)
    simulate(maker.store, actions, study, Preferences(worth=WORTH, noise=0.4, careless=1.0), raters=6, seed=2)
    rows = rater_rows(maker.store, study).raters
    careful, careless = rows[:6], rows[6:]
    assert sum(row.checks_failed for row in careful) == 0
    assert sum(row.checks_failed for row in careless) >= 8
    mean = [np.mean([row.agreement for row in group]) for group in (careful, careless)]
    assert mean[0] > mean[1] + 0.3
    before = results(maker.store, study)
    for row in careless:
        actions.exclude(study, row.id, is_excluded=True, reason="checks failed")
    after = results(maker.store, study)
    assert (before.judgements, after.judgements, after.excluded) == (144, 72, 6)
    alpha = [next(r.alpha for r in told.agreement if r.question == "overall_preference") for told in (before, after)]
    assert alpha[1] > alpha[0] + 0.2
    assert actions.row(study).raters_wanted == 18  # their tasks are given out once more


def test_made_up_raters_of_candidates_agree_on_the_best(maker: Maker):
    study = canned.make_preference(maker, raters=8)
    simulate(
        maker.store,
        OwnerActions(maker, "test"),
        study,
        Preferences(worth={"default": 0.0}, skips=0.1),
        raters=8,
        seed=3,
    )
    found = results(maker.store, study)
    assert found.judgements == 24
    assert sum(row.is_kept for row in found.preferences) >= 1
    best = next(row for row in found.agreement if row.question == "best")
    assert best.alpha == pytest.approx(best.alpha)
    assert best.alpha > 0.1
