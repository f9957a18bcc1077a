import numpy as np

from echoavatar_character.eyes import FAR, IRIS, paint_eye
from echoavatar_character.person import PEOPLE


def test_an_eye_has_pupil_iris_ring_and_white() -> None:
    """Along a line to the side: black, coloured, darker at the ring, bright beyond."""
    eye = paint_eye(PEOPLE["theo"], 400)
    edge = IRIS / FAR * 200
    pupil, iris, ring, white = (eye[200, round(200 + edge * at)].mean() for at in (0.1, 0.6, 0.95, 1.3))
    assert pupil < 0.05 < ring < iris < white
    assert white > 0.6
    assert np.isfinite(eye).all()
