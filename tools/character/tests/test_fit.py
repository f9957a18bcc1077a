import numpy as np

from echoavatar_character import fit
from echoavatar_character.bends import bent
from echoavatar_character.body import Body


def test_a_swing_brings_one_direction_onto_another() -> None:
    a, b = np.array([1.0, 0, 0]), np.array([0.3, -0.8, 0.5])
    turned = fit._swing(a, b) @ a
    np.testing.assert_allclose(turned, b / np.linalg.norm(b))


def test_undoing_the_pose_and_posing_again_returns_the_shape(body: Body) -> None:
    """Linear blend skinning of the T-pose, in the modelled pose, gives back what was modelled, to a hair."""
    weights = bent(body.weights, body.points, body)
    rest = fit.to_rest(body.fitted, body.points, weights)
    maps = np.einsum("vj,jik->vik", weights, body.fitted.pose)
    again = np.einsum("vik,vk->vi", maps[:, :, :3], rest) + maps[:, :, 3]
    np.testing.assert_allclose(again, body.points, atol=1e-9)
    feet = rest[:13380]
    assert abs(feet[:, 1].min() - fit.SOLE) < 0.02
