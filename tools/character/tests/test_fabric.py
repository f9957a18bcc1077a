import numpy as np

from echoavatar_character.fabric import knit, normal_map, twill


def test_cloth_repeats_without_a_seam() -> None:
    """Across the edge a picture changes no more than from one row or column to the next inside."""
    for picture in (knit(), twill()):
        assert picture.min() >= 0
        assert picture.max() <= 1
        assert picture.std() > 0.02
        for axis in (0, 1):
            inside = np.abs(np.diff(picture, axis=axis)).mean(1 - axis)
            seam = np.abs(np.take(picture, 0, axis) - np.take(picture, -1, axis)).mean()
            assert seam < 1.6 * inside.max()


def test_a_normal_map_of_a_ridge_faces_away_from_it() -> None:
    """Left of a ridge normals lean to the left, above it upwards, and flat cloth looks straight out."""
    heights = np.zeros((8, 8))
    heights[4, 4] = 1
    normals = 2 * normal_map(heights, 1) - 1
    assert normals[4, 3, 0] < -0.4 < 0.4 < normals[4, 5, 0]
    assert normals[5, 4, 1] < -0.4 < 0.4 < normals[3, 4, 1]
    np.testing.assert_allclose(normals[0, 0], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1)
