import numpy as np

from echoavatar_character import atlas


def test_a_drawn_triangle_holds_its_corners_values_and_gaps_are_filled() -> None:
    """Half of the picture is covered; every gap takes a value that is there."""
    uvs = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    values = np.array([[[0.0], [1.0], [0.0]]])
    picture, covered = atlas.spread(uvs, values, 32)
    assert abs(covered.mean() - 0.5) < 0.06
    assert abs(picture[2, 16, 0] - 16.5 / 32) < 0.02
    whole = atlas.filled(picture, covered)
    assert (
        whole[31, 31, 0]
        == picture[np.nonzero(covered)].reshape(-1)[np.abs(picture[np.nonzero(covered)] - whole[31, 31]).argmin()]
    )


def test_islands_share_no_place() -> None:
    """Goals of islands and rectangles do not overlap, so that no part wears the paint of another."""
    boxes = [island.goal for island in atlas.ISLANDS] + [atlas.EYE, atlas.TEETH, atlas.TONGUE, atlas.LASH]
    for i, (a, b, c, d) in enumerate(boxes):
        for e, f, g, h in boxes[i + 1 :]:
            assert c <= e or g <= a or d <= f or h <= b


def test_noise_is_smooth_and_the_same_each_time() -> None:
    points = np.linspace(0, 1, 300)[:, None] * np.ones(3)
    one = atlas.noise(points, 0.1, 3)
    np.testing.assert_array_equal(one, atlas.noise(points, 0.1, 3))
    assert np.abs(np.diff(one)).max() < 0.5 < np.ptp(one)
