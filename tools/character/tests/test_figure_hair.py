import numpy as np

from echoavatar_character.figure_hair import hair


def test_hair_covers_crown_and_back_and_leaves_the_face_free() -> None:
    covered = np.array([[0.0, 1.69, -0.02], [0.0, 1.62, -0.105], [0.08, 1.64, -0.02], [-0.08, 1.64, -0.02]])
    free = np.array([[0.0, 1.585, 0.09], [0.03, 1.55, 0.08], [0.0, 1.46, 0.0], [0.085, 1.565, -0.005]])
    assert (hair(covered) < 0).all()
    assert (hair(free) > 0).all()
