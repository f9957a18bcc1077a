import pytest
from pydantic import ValidationError

from echoavatar.pulse.config import PulseConfig, PulseTraining


def test_two_seconds_of_past_reach_each_frame() -> None:
    encoder = PulseConfig().encoder
    assert encoder.blocks * encoder.past == 60  # frames of 1/30 s


@pytest.mark.parametrize("wrong", [{"frames": 20}, {"steps": 0}, {"gain_db": -1}])
def test_impossible_training_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        PulseTraining.model_validate(wrong)
