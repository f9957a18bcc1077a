import pytest

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character.figure_hands import hands, nail_mask

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_hand_has_five_separate_fingers(side: str) -> None:
    """Each finger's last joint is inside flesh; half way to the neighbour's there is air."""
    tips = HUMANOID.rest_positions.numpy()[HUMANOID.indices([f"{side}{f}Distal" for f in FINGERS])].astype(float)
    assert (hands(tips) < -0.004).all()
    between = (tips[1:-1] + tips[2:]) / 2
    assert (hands(between) > 0.0005).all()
    assert hands((tips[:1] + tips[1:2]) / 2)[0] > 0.01


def test_nails_are_on_the_backs_of_the_fingers() -> None:
    tip = HUMANOID.rest_positions.numpy()[HUMANOID.index("leftMiddleDistal")].astype(float) + [0.018, 0, 0]
    assert nail_mask((tip + [0, 0.006, 0])[None])[0] < 0 < nail_mask((tip - [0, 0.006, 0])[None])[0]
