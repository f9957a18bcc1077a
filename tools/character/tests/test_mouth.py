import numpy as np

from echoavatar_character import mouth
from echoavatar_character.body import Body


def test_lower_teeth_follow_the_jaw_and_upper_teeth_stay(body: Body) -> None:
    """Rows stay rigid: the width of the lower row changes by less than a millimetre."""
    upper, lower = mouth.teeth(body, upper=True), mouth.teeth(body, upper=False)
    assert not upper.moves
    moved = lower.positions + lower.moves["jawOpen"]
    assert lower.moves["jawOpen"][:, 1].mean() < -0.008
    assert abs(np.ptp(moved[:, 0]) - np.ptp(lower.positions[:, 0])) < 0.001
    assert "tongueOut" in mouth.tongue(body).moves
