import pytest
from pydantic import ValidationError

from echoavatar.models.warp import WarpConfig


def test_two_seconds_of_past_reach_each_frame() -> None:
    encoder = WarpConfig().encoder
    assert encoder.blocks * encoder.past == 60  # frames of 1/30 s


def test_a_curve_can_not_be_turned_round() -> None:
    with pytest.raises(ValidationError, match="sharpness"):
        WarpConfig(sharpness=-1.0)
