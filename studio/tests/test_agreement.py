"""Krippendorff's alpha: by hand, and against another implementation."""

import krippendorff
import numpy as np
import pytest

from echoavatar_studio.agreement import alpha


def test_two_raters_by_hand():
    """Units (1,1) (2,2) (1,2). Coincidences o11 = 2, o22 = 2, o12 = o21 = 1, n = 6, n1 = n2 = 3.

    Observed disagreement 2/6; expected 2 * 3 * 3 / (6 * 5) = 0.6. alpha = 1 - (1/3) / 0.6 = 4/9.
    """
    assert alpha([[1, 1], [2, 2], [1, 2]], "nominal") == pytest.approx(4 / 9)


def test_full_agreement_is_one_and_nothing_to_agree_on_is_undefined():
    assert alpha([[1, 1, 1], [2, 2]], "ordinal") == pytest.approx(1)
    assert alpha([[1, 1], [1, 1]], "interval") is None
    assert alpha([[1], [2], []], "nominal") is None


@pytest.mark.parametrize("metric", ["nominal", "ordinal", "interval"])
@pytest.mark.parametrize("seed", range(4))
def test_another_implementation_says_the_same(metric, seed):
    random = np.random.default_rng(seed)
    truth = random.integers(-2, 3, size=30)
    table = np.clip(truth + random.integers(-1, 2, size=(6, 30)), -2, 2).astype(float)
    table[random.random(table.shape) < 0.4] = np.nan
    units = [column[~np.isnan(column)].tolist() for column in table.T]
    theirs = krippendorff.alpha(reliability_data=table, level_of_measurement=metric)
    assert alpha(units, metric) == pytest.approx(theirs, abs=1e-12)
