import numpy as np
import pytest

from echoavatar_character import sdf
from echoavatar_character.sculpt import sample, sculpt


def ball(p: np.ndarray) -> np.ndarray:
    return sdf.sphere(p, (0.01, 0, 0), 0.1)


def test_sparse_sampling_equals_dense_sampling_at_the_surface() -> None:
    origin, volume = sample(ball, np.full(3, -0.15, np.float32), np.full(3, 0.15, np.float32), 0.01)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in volume.shape), indexing="ij"), -1).reshape(-1, 3)
    dense = ball(origin + grid * 0.01).reshape(volume.shape)
    near = np.abs(dense) < 0.02
    np.testing.assert_allclose(volume[near], dense[near], atol=1e-6)
    assert (np.sign(volume[~near]) == np.sign(dense[~near])).all()


def test_a_sculpted_ball_is_closed_light_and_faces_outwards() -> None:
    pytest.importorskip("skimage")
    mesh = sculpt(ball, (-0.15,) * 3, (0.15,) * 3, cell=0.008, triangles=600)
    assert 400 < len(mesh.triangles) < 800
    radius = np.linalg.norm(mesh.positions - [0.01, 0, 0], axis=1)
    np.testing.assert_allclose(radius, 0.1, atol=1e-5)
    a, b, c = (mesh.positions[mesh.triangles[:, i]].astype(float) for i in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.03)
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # every edge has two sides: no hole
