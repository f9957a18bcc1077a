import numpy as np
import pytest

raster = pytest.importorskip("echoavatar.files.avatar.raster", reason="the render extra is not installed")


def _visible(  # type: ignore[no-untyped-def]
    screen: list[list[float]], triangles: list[list[int]], cutouts: list[bool], alpha: list[int], is_sheer: bool = False
):
    """Which triangle each of 20 x 20 pixels shows; one picture, of texels side by side with these alphas."""
    depth, ids = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.int32)
    corners = np.array(screen, np.float32)
    texels = np.zeros((len(alpha), 4), np.uint8)
    texels[:, 3] = alpha
    table = np.array([[[0, len(alpha), 1]] * 2])
    uvs = (corners[:, :2] / 20).astype(np.float32)
    index, both = np.array(triangles, np.int32), np.array(cutouts)
    cut, sheer = np.where(both, 0, -1), both & is_sheer
    raster.visible(corners, index, depth, ids, (0, 0, 20, 20), uvs, both, cut, sheer, texels, table)
    return ids


def test_a_triangle_covers_half_its_box_and_nearer_ones_win() -> None:
    screen = [[0, 0, 0.5], [0, 20, 0.5], [20, 0, 0.5], [0, 0, 0.9], [0, 4, 0.9], [4, 0, 0.9]]
    ids = _visible(screen, [[0, 1, 2], [3, 4, 5]], [False, False], [255])
    assert abs((ids >= 0).sum() - 200) <= 20
    assert ids[0, 0] == 1
    assert ids[5, 5] == 0
    assert ids[19, 19] == -1


def test_whatever_the_coordinates_nothing_is_written_beside_the_box() -> None:
    """20,000 triangles with corners that are tiny, huge or not finite; the arrays lie between others."""
    random = np.random.default_rng(0)
    odd = np.float32([0, 1e-20, -1e-30, 1e9, 1e19, -1e20, 1e30, 3e38, np.nan, np.inf, -np.inf])
    triangle, none, both = np.array([[0, 1, 2]], np.uint32), np.array([-1], np.int32), np.array([True])
    texels, table, still = np.zeros((1, 4), np.uint8), np.ones((1, 2, 3), np.int64), np.eye(3, 4, dtype=np.float32)
    depth, shadow, ids = (np.full((60, 20), 7, dtype) for dtype in (np.float32, np.float32, np.int32))
    for _ in range(20_000):
        corners = random.uniform(0.1, 20, (3, 3)).astype(np.float32)
        corners[random.integers(3, size=4), random.integers(2, size=4)] = random.choice(odd, 4)
        seen = depth[20:40], ids[20:40]
        raster.visible(corners, triangle, *seen, (2, 2, 18, 18), corners, both, none, both, texels, table)
        raster.shadow_depth(corners, triangle, both, still, corners.copy(), shadow[20:40])
    ids[22:38, 2:18] = depth[22:38, 2:18] = shadow[20:40] = 7
    for array in (ids, depth, shadow):
        assert (array == 7).all()


def test_backs_are_left_out_only_where_all_of_them_is_hidden() -> None:
    """Slanting two-sided triangles before, in and behind a wall: each drawn alone, the nearest is seen."""
    random = np.random.default_rng(1)
    places = random.uniform(0, 60, (300, 1, 2)) + random.normal(0, 8, (300, 3, 2))
    screen = np.concatenate([places, random.uniform(0.3, 0.7, (300, 3, 1))], 2).astype(np.float32).reshape(-1, 3)
    screen[:3] = [[-90, -90, 0.5], [-90, 190, 0.5], [190, -90, 0.5]]
    triangles, both, none = np.arange(900, dtype=np.uint32).reshape(300, 3), np.ones(300, bool), np.full(300, -1)
    texels, table = np.zeros((1, 4), np.uint8), np.ones((1, 2, 3), np.int64)

    def drawn(some: np.ndarray) -> np.ndarray:
        depth, ids = np.zeros((60, 60), np.float32), np.zeros((60, 60), np.int32)
        rest = (np.zeros((900, 2), np.float32), both, none.astype(np.int32), ~both, texels, table)
        raster.visible(screen, some, depth, ids, (0, 0, 60, 60), *rest)
        return depth

    alone = np.max([drawn(triangles[i : i + 1]) for i in range(300)], 0)
    np.testing.assert_array_equal(drawn(triangles), alone)


def test_a_cut_out_is_seen_from_behind_and_only_where_its_picture_is() -> None:
    screen = [[0, 0, 0.5], [20, 0, 0.5], [0, 20, 0.5]]
    assert (_visible(screen, [[0, 1, 2]], [False], [255, 0]) == -1).all()
    ids = _visible(screen, [[0, 1, 2]], [True], [255, 0])
    assert (ids[1, :9] == 0).all()
    assert (ids[1, 11:] == -1).all()


@pytest.mark.parametrize(("alpha", "share"), [(10, 0), (64, 1 / 4), (128, 2 / 4), (255, 1)])
def test_glass_is_seen_in_as_many_samples_as_its_alpha_says(alpha: int, share: float) -> None:
    """Over another surface; its picture repeats, so that places outside it count as those inside."""
    screen = [[-90, -90, 0.5], [90, -90, 0.5], [-90, 190, 0.5], [-90, -90, 0.4], [90, -90, 0.4], [-90, 190, 0.4]]
    ids = _visible(screen, [[3, 4, 5], [0, 1, 2]], [True, True], [alpha], is_sheer=True)
    assert (ids == 1).mean() == share


def test_the_shadow_map_keeps_the_highest_surface() -> None:
    corners = np.array([[0, 0], [32, 0], [0, 32]], np.float32)
    light = np.concatenate([np.c_[corners, np.full(3, height)] for height in (1.0, 2.0)]).astype(np.float32)
    shadow = np.zeros((32, 32), np.float32)
    still = np.eye(3, 4, dtype=np.float32)
    triangles = np.array([[3, 4, 5], [0, 1, 2]], np.int32)
    raster.shadow_depth(light, triangles, np.zeros(2, bool), still, np.zeros_like(light), shadow)
    assert shadow[4, 4] == 2
    assert shadow[31, 31] < -1e8
