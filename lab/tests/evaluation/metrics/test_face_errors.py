import numpy as np
import pytest

from echoavatar.files.avatar.character import load_character
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.evaluation.metrics.face_errors import errors_on_mesh, face_lvd, face_mse

# emage_evaltools, MSEFace and LVDFace, on the arrays below, computed once
MSE, LVD = 0.2964656035, 0.5780929943


def curves(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (300, len(ARKIT_NAMES)))


def test_the_formulas_are_emages() -> None:
    made = np.random.default_rng(1).normal(0, 0.5, (20, 6))
    true = np.random.default_rng(2).normal(0, 0.4, (20, 6))
    assert face_mse(made, true) == pytest.approx(MSE)
    assert face_lvd(made, true) == pytest.approx(LVD)


def test_on_the_mesh_they_are_those_of_its_vertices() -> None:
    made, true = curves(0), curves(1)
    face = load_character().face
    used = np.unique(face.vertices)
    sides = []
    for one in (made, true):
        vertices = np.zeros((len(one), len(used), 3))
        for name, at, moves, _ in face.on(used):
            if name in ARKIT_NAMES:
                vertices[:, at] += one[:, ARKIT_NAMES.index(name), None, None] * moves
        sides.append(vertices.reshape(len(one), -1))
    assert errors_on_mesh(made, true) == pytest.approx((face_mse(*sides), face_lvd(*sides)))
    assert errors_on_mesh(true, true) == (0, 0)
