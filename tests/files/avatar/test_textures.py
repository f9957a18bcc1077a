import numpy as np

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.textures import LEVELS, NAMES, Textures, decoded, looked_up


def test_pictures_come_back_with_their_reductions() -> None:
    """Each level has half the sides of the one before; only hair has clear texels."""
    textures = load_character().textures
    texels = decoded(textures)
    assert texels.table.shape == (len(NAMES), LEVELS, 3)
    np.testing.assert_array_equal(texels.table[:, 1, 1:] * 2, texels.table[:, 0, 1:])
    for row, name in enumerate(NAMES):
        start, width, height = texels.table[row, 0]
        alpha = texels.values[start : start + width * height, 3]
        assert (alpha.min() < 10) == (name == "hair")


def test_bytes_are_kept_whole() -> None:
    textures = load_character().textures
    assert Textures.of_arrays(textures.arrays()) == textures


def test_places_find_their_colour() -> None:
    """A place outside any picture is white; skin is redder than blue wherever a face lies."""
    character = load_character()
    texels = decoded(character.textures)
    found = looked_up(texels, np.array([-1, 0]), np.array([[0.5, 0.5], [0.45, 0.5]], np.float32))
    np.testing.assert_array_equal(found[0], 1)
    assert found[1, 0] > found[1, 2]
