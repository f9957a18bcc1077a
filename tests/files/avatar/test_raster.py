import numpy as np
import pytest

raster = pytest.importorskip("echoavatar.files.avatar.raster", reason="the render extra is not installed")


def test_a_triangle_covers_half_its_box_and_nearer_ones_win() -> None:
    screen = np.array([[0, 0, 0.5], [0, 20, 0.5], [20, 0, 0.5], [0, 0, 0.9], [0, 4, 0.9], [4, 0, 0.9]], np.float32)
    depth, ids = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.int32)
    raster.visible(screen, np.array([[0, 1, 2], [3, 4, 5]], np.int32), depth, ids)
    assert abs((ids >= 0).sum() - 200) <= 20
    assert ids[0, 0] == 1
    assert ids[5, 5] == 0
    assert ids[19, 19] == -1


def test_the_shadow_map_keeps_the_highest_surface() -> None:
    corners = np.array([[0, 0], [32, 0], [0, 32]], np.float32)
    light = np.concatenate([np.c_[corners, np.full(3, height)] for height in (1.0, 2.0)]).astype(np.float32)
    shadow = np.zeros((32, 32), np.float32)
    raster.shadow_depth(light, np.array([[3, 4, 5], [0, 1, 2]], np.int32), shadow)
    assert shadow[4, 4] == 2
    assert shadow[31, 31] < -1e8
