import numpy as np

from echoavatar_character.relax import flipped, relax, slid


def grid(rng: np.random.Generator, size: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """A flat sheet whose inner vertices are shaken."""
    x, y = (a.reshape(-1) for a in np.meshgrid(np.arange(size), np.arange(size)))
    points = np.stack([x, y, 0 * x], 1).astype(float)
    inner = (x > 0) & (x < size - 1) & (y > 0) & (y < size - 1)
    points[inner, :2] += rng.uniform(-0.3, 0.3, (int(inner.sum()), 2))
    a = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 1, a + size + 1], 1), np.stack([a, a + size + 1, a + size], 1)])
    return points, faces


def least_angle(points: np.ndarray, faces: np.ndarray) -> float:
    angles = []
    for i in range(3):
        u = points[faces[:, (i + 1) % 3]] - points[faces[:, i]]
        v = points[faces[:, (i + 2) % 3]] - points[faces[:, i]]
        cos = np.einsum("fi,fi->f", u, v) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        angles.append(np.arccos(np.clip(cos, -1, 1)))
    return float(np.quantile(np.min(angles, axis=0), 0.05))


def test_triangles_become_rounder_and_the_sheet_stays_whole() -> None:
    points, faces = grid(np.random.default_rng(0))
    new_points, new_faces = relax(points, faces)
    assert least_angle(new_points, new_faces) > 1.2 * least_angle(points, faces)
    a, b, c = (new_points[new_faces[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)[:, 2] / 2
    assert area.min() > 0
    np.testing.assert_allclose(area.sum(), 64)  # 8 x 8, nothing overlaps, no hole
    np.testing.assert_allclose(new_points[:, 2], 0, atol=1e-12)


def test_the_border_stays() -> None:
    points, faces = grid(np.random.default_rng(1))
    border = (points[:, 0] % 8 == 0) | (points[:, 1] % 8 == 0)
    np.testing.assert_array_equal(slid(points, faces, 0.5)[border], points[border])


def test_a_crease_keeps_its_edges() -> None:
    """A roof: its ridge is the longer diagonal's rival, but flipping would cut the ridge away."""
    points = np.array([[0.0, 0, 1], [4, 0, 1], [2, 1, 0], [2, -1, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    np.testing.assert_array_equal(np.sort(flipped(points, faces), axis=1), np.sort(faces, axis=1))
