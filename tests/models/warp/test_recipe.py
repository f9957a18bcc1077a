import pytest
from pydantic import ValidationError

from echoavatar.models.warp.recipe import WarpTraining


@pytest.mark.parametrize("wrong", [{"frames": 20}, {"steps": 0}, {"gain_db": -1}])
def test_impossible_training_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        WarpTraining.model_validate(wrong)
