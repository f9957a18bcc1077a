import numpy as np
from scipy.spatial import cKDTree

from echoavatar_character import clothes
from echoavatar_character.body import Body
from echoavatar_character.surface import Surface, normals


def test_clothes_lie_outside_the_body_and_have_closed_hems(body: Body, whole: Surface) -> None:
    """Nearly all cloth that is seen is on the outer side of the nearest skin; of trousers the jumper hides the top."""
    out = normals(whole.positions, whole.quads)
    cloth = clothes.tights(body)
    top = clothes.top(body, cloth)
    for piece in (top, clothes.trousers(cloth, top, clothes.shoes(body, cloth))):
        near = cKDTree(whole.positions).query(piece.positions)[1]
        height = np.einsum("vi,vi->v", piece.positions - whole.positions[near], out[near])
        seen = (piece.positions[:, 1] < clothes.HEM - 0.01) | (piece.material == "cloth")
        assert (height[seen] > -0.004).mean() > 0.92


def test_a_cut_follows_its_line(body: Body) -> None:
    cloth = clothes.tights(body)
    piece, at = clothes._cut(cloth, cloth.positions[:, 1] - 1.0)
    assert piece.positions[:, 1].min() > 0.985
    assert (at >= 0).all()
