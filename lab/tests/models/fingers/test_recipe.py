import pytest

from echoavatar_lab.models.fingers.recipe import FingerTraining


def test_the_rate_ends_at_its_final_share() -> None:
    training = FingerTraining(steps=100, warmup=0)
    assert training.rate_at(100) == pytest.approx(0.03 * training.learning_rate)
    assert training.rate_at(0) == pytest.approx(training.learning_rate)
