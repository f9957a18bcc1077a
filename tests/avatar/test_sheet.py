from pathlib import Path

import numpy as np

from echoavatar.avatar.sheet import contact_sheet, face_sheet, save_picture
from echoavatar.kinematics import HUMANOID, Motion


def test_pictures_run_left_to_right_and_the_last_frame_fills_up(tmp_path: Path) -> None:
    """Three frames in a 2 x 2 grid: the body sinks out of the picture, the fourth cell repeats the third."""
    turns = np.zeros((3, 52, 4), np.float32)
    turns[..., 0] = 1
    root = np.array([[0, 0.95, 0], [0, -0.4, 0], [0, -3.0, 0]], np.float32)
    sheet = contact_sheet(Motion(HUMANOID, turns, root, 30.0), columns=2, rows=2, every=1, size=(40, 60))
    assert sheet.shape == (120, 80, 3)
    first, second, third, fourth = sheet[:60, :40], sheet[:60, 40:], sheet[60:, :40], sheet[60:, 40:]
    assert not np.array_equal(first, second)
    assert np.array_equal(third, fourth)
    save_picture(tmp_path / "sheet.png", sheet)
    assert (tmp_path / "sheet.png").read_bytes()[1:4] == b"PNG"


def test_every_shape_has_its_own_picture(tmp_path: Path) -> None:
    """Rest and four shapes, no two alike; the jaw's cell has more dark (an open mouth) than the face at rest."""
    sheet = face_sheet(("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "tongueOut"), columns=3, size=(40, 44))
    assert sheet.shape == (2 * 44, 3 * 40, 3)
    cells = sheet.reshape(2, 44, 3, 40, 3).transpose(0, 2, 1, 3, 4).reshape(6, 44, 40, 3).astype(int)
    assert len({cell.tobytes() for cell in cells[:5]}) == 5
    assert not cells[5].any()
    dark = (cells[:, 22:].sum(3) < 120).sum((1, 2))
    assert dark[1] > dark[0] + 5
    save_picture(tmp_path / "faces.jpg", sheet)
    assert (tmp_path / "faces.jpg").read_bytes()[:2] == b"\xff\xd8"
