from pathlib import Path

import numpy as np

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.evaluation.pictures import contact_sheet, save_picture


def test_the_camera_keeps_up_with_who_walks() -> None:
    turns = np.zeros((300, 52, 4), np.float32)
    turns[..., 0] = 1
    stands = np.tile(np.array([0, 0.95, 0], np.float32), (300, 1))
    walks = stands + np.linspace(0, 9, 300)[:, None] * np.array([1, 0, 0], np.float32)
    still, walking = (
        contact_sheet(Motion(HUMANOID, turns, root, 30.0), columns=3, rows=1, size=(40, 60)).astype(int)
        for root in (stands, walks)
    )
    assert np.abs(still - walking).mean() < 2


def test_pictures_run_left_to_right_and_the_last_frame_fills_up(tmp_path: Path) -> None:
    """Three frames in a 2 x 2 grid: the body sinks, the fourth cell repeats the third (the camera may still follow)."""
    turns = np.zeros((3, 52, 4), np.float32)
    turns[..., 0] = 1
    root = np.array([[0, 0.95, 0], [0, -0.4, 0], [0, -3.0, 0]], np.float32)
    sheet = contact_sheet(Motion(HUMANOID, turns, root, 30.0), columns=2, rows=2, every=1, size=(40, 60))
    assert sheet.shape == (120, 80, 3)
    first, second, third, fourth = sheet[:60, :40], sheet[:60, 40:], sheet[60:, :40], sheet[60:, 40:]
    assert not np.array_equal(first, second)
    apart = [np.abs(third.astype(int) - other).mean() for other in (fourth, second, first)]
    assert apart[0] < 0.5 * min(apart[1:])
    save_picture(tmp_path / "sheet.png", sheet)
    assert (tmp_path / "sheet.png").read_bytes()[1:4] == b"PNG"
