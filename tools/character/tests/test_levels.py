import numpy as np
import pytest

from echoavatar.files.avatar import LEVELS, MATERIALS, load_character
from echoavatar_character.levels import CAPS, HAIR, PICTURES, TOOLS, TRIANGLES, part, simplified


def test_a_part_keeps_places_and_face_of_the_vertices_that_it_uses() -> None:
    character = load_character("maya")
    piece = part(character, character.triangles[::7])
    assert len(piece.positions) < len(character.positions)
    jaw = np.zeros(52, np.float32)
    jaw[character.face.names.index("jawOpen")] = 1
    (whole, _), (some, _) = character.with_face(jaw), piece.with_face(jaw)
    np.testing.assert_array_equal(some[piece.triangles], whole[character.triangles[::7]])


def test_there_is_a_setting_for_every_level() -> None:
    assert len(TRIANGLES) == len(HAIR) == len(CAPS) == len(PICTURES) == LEVELS


@pytest.mark.skipif(not (TOOLS / "node_modules").is_dir(), reason="needs `npm ci` in tools/character")
def test_the_coarsest_level_keeps_bounds_and_materials() -> None:
    character = load_character("theo")
    coarse = simplified(character, 2)
    assert len(coarse.triangles) < 7_000
    assert set(coarse.materials) == set(range(len(MATERIALS)))
    np.testing.assert_allclose(np.ptp(coarse.positions, axis=0), np.ptp(character.positions, axis=0), atol=0.02)
