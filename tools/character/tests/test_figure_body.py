import numpy as np

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_character import figure_body as body


def test_clothes_enclose_the_joints_they_dress() -> None:
    rest = HUMANOID.rest_positions.numpy()
    for field, names in (
        (body.jacket, ("chest", "leftUpperArm", "leftLowerArm", "rightLowerArm")),
        (body.trousers, ("leftUpperLeg", "leftLowerLeg", "rightLowerLeg")),
        (body.shoes, ("leftToes", "rightToes")),
    ):
        outside = rest[HUMANOID.indices(names)] * [1, 1, 0] + rest[HUMANOID.indices(names)] * [0, 0, 1]
        if field is body.jacket:
            outside[0, 2] -= 0.06  # the front is open: behind the spine instead
        assert (field(outside.astype(float)) < 0).all(), names


def test_the_jacket_is_open_in_front_and_closed_behind() -> None:
    assert body.jacket(np.array([[0.0, 1.2, 0.115]]))[0] > 0
    assert body.jacket(np.array([[0.0, 1.2, -0.115]]))[0] < 0
    assert body.shirt(np.array([[0.0, 1.2, 0.10]]))[0] < 0


def test_soles_stand_on_the_floor() -> None:
    """The lowest point of the shoes is within a millimetre of y = 0."""
    x, y, z = np.meshgrid(np.linspace(0.05, 0.13, 20), np.linspace(-0.003, 0.006, 10), np.linspace(-0.05, 0.1, 20))
    p = np.stack([x, y, z], -1).reshape(-1, 3)
    lowest = p[body.soles(p) <= 0][:, 1].min()
    assert -0.0005 <= lowest <= 0.0015
