import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.files.avatar.framing import VIEWS
from echoavatar.motion.kinematics import HUMANOID

EYE = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
REST = HUMANOID.rest_positions


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_shows_the_character_in_its_middle_and_leaves_the_corners(view) -> None:
    picture = AvatarRenderer(load_character(), Shot((64, 64), view, alpha=True, samples=1)).draw(EYE, REST)
    assert picture[32, 32, 3] == 255
    assert picture[2, 2, 3] == 0


def test_a_twin_draws_the_same() -> None:
    first = AvatarRenderer(load_character(), Shot((64, 64), "bust", "#112233", samples=1))
    np.testing.assert_array_equal(first.draw(EYE, REST), first.twin().draw(EYE, REST))
