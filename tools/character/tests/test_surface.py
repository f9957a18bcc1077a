import numpy as np

from echoavatar_character.surface import border, make, normals, part, smoothed, subdivided, triangles

QUADS = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
POINTS = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], float)


def test_a_quad_is_two_triangles_and_a_repeated_corner_one() -> None:
    assert len(triangles(QUADS)) == 4
    assert len(triangles(np.array([[0, 1, 2, 2]]))) == 1
    np.testing.assert_allclose(normals(POINTS, QUADS), np.tile([0, 0, 1.0], (6, 1)))


def test_dividing_keeps_a_flat_sheet_flat_and_its_rim_in_place() -> None:
    surface = make(POINTS, QUADS, np.ones((6, 1)), "cloth", moves={"jawOpen": np.ones((6, 3))})
    fine = subdivided(surface)
    assert len(fine.quads) == 8
    np.testing.assert_allclose(fine.positions[:, 2], 0)
    assert fine.positions[:, 0].max() > 1.7
    np.testing.assert_allclose(fine.moves["jawOpen"], 1)
    np.testing.assert_allclose(normals(fine.positions, fine.quads)[:, 2], 1)


def test_a_part_keeps_only_what_it_uses_and_the_border_is_closed() -> None:
    surface = part(make(POINTS, QUADS, np.ones((6, 1)), "cloth"), np.array([True, False]))
    assert len(surface.positions) == 4
    rim = border(surface.quads)
    assert sorted(rim[:, 0]) == sorted(rim[:, 1]) == [0, 1, 2, 3]


def test_smoothing_brings_values_together() -> None:
    values = np.array([[0.0], [3.0], [0.0], [0.0], [0.0], [0.0]])
    assert np.ptp(smoothed(values, QUADS, 5)) < 1
