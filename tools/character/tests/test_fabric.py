import numpy as np

from echoavatar_character.fabric import knit, twill


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
