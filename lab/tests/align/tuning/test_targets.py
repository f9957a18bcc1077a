"""Weights follow their targets."""

import pytest

from echoavatar_lab.align.tuning.targets import Target, Weights

LEAST = Target(aim=10, weight=1, low=0.5, high=2)
MOST = LEAST.model_copy(update={"is_least": False})


@pytest.mark.parametrize(
    ("target", "mean", "grows"), [(LEAST, 8, True), (LEAST, 12, False), (MOST, 12, True), (MOST, 8, False)]
)
def test_a_weight_grows_while_its_mean_is_short(target: Target, mean: float, grows: bool) -> None:
    weights = Weights({"turn": target})
    weights.see("turn", mean)
    assert (weights.values["turn"] > 1) is grows
    for _ in range(200):
        weights.see("turn", mean)
    assert weights.values["turn"] == (2 if grows else 0.5)  # its bounds


def test_a_mean_that_is_not_finite_changes_nothing() -> None:
    weights = Weights({"turn": LEAST})
    weights.see("turn", float("nan"))
    assert weights.values["turn"] == 1
    assert not weights.means
