from echoavatar_character import clothes
from echoavatar_character.body import Body
from echoavatar_character.pieces import cut


def test_a_cut_follows_its_line(body: Body) -> None:
    cloth = clothes.tights(body)
    piece, at = cut(cloth, cloth.positions[:, 1] - 1.0)
    assert piece.positions[:, 1].min() > 0.985
    assert (at >= 0).all()
