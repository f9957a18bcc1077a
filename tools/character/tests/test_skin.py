import numpy as np

from echoavatar_character import skin
from echoavatar_character.body import Body
from echoavatar_character.surface import Surface


def test_lips_are_redder_than_cheeks_and_brows_darker(body: Body, whole: Surface) -> None:
    picture = skin.paint(body, whole, np.zeros(len(whole.positions)), size=512)
    assert picture.shape == (512, 512, 3)
    assert np.isfinite(picture).all()

    def at(point: np.ndarray) -> np.ndarray:
        vertex = np.linalg.norm(whole.positions - point, axis=1).argmin()
        uv = whole.uvs.reshape(-1, 2)[(whole.quads.ravel() == vertex).argmax()] * 512
        return picture[int(uv[1]) - 1 : int(uv[1]) + 2, int(uv[0]) - 1 : int(uv[0]) + 2].mean((0, 1))

    eye = body.eyes["Left"].middle
    cheek = at(np.array([0.04, eye[1] - 0.035, 0.11]))
    brow = at(np.array([*skin.brow_curve(body, np.array([0.45]))[0][0], 0.12]))
    assert brow.mean() < cheek.mean() - 0.08


def test_skin_below_clothes_is_left_out(body: Body, whole: Surface) -> None:
    seen = skin.seen_skin(whole, body, np.where(whole.positions[:, 1] > 1.45, -0.1, 0.2))
    assert 0.3 < len(seen.quads) / len(whole.quads) < 0.7
