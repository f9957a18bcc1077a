import pytest
from pydantic import ValidationError

from echoavatar_lab.models.generator.recipe import GeneratorTraining


def test_the_default_is_stage_two_and_unknown_choices_are_refused():
    training = GeneratorTraining()
    assert (training.objective, training.exemplar, training.corruption) == ("motion", 0.0, "hierarchical")
    assert training.rate_at(0) == pytest.approx(training.learning_rate / 100)
    assert training.rate_at(3000) == pytest.approx(0.05 * training.learning_rate)
    with pytest.raises(ValidationError, match="objective"):
        GeneratorTraining(objective="stage 4")
    with pytest.raises(ValidationError, match="learning"):
        GeneratorTraining(learning=1)
