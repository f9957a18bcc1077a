import numpy as np

from echoavatar_character import figure_mouth as mouth


def test_closing_brings_the_edges_of_the_cut_together() -> None:
    """Points on both edges of the modelled mouth land on the line between the lips."""
    x = np.linspace(0, 0.9 * mouth.WIDE, 12)
    half = np.asarray([mouth.GAP * (1 - (v / mouth.WIDE) ** 2) ** 0.7 for v in x])
    for side in (1.0, -1.0):
        p = np.stack([x, mouth.line(x) + side * half, np.full(12, 0.09)], 1)
        np.testing.assert_array_equal(mouth.above(p), side)
        np.testing.assert_allclose(mouth.closed(p)[:, 1], mouth.line(x), atol=1e-6)


def test_closing_leaves_forehead_and_chin_and_nape() -> None:
    far = np.array([[0.0, 1.60, 0.09], [0.0, 1.48, 0.08], [0.0, 1.52, -0.07], [0.04, 1.52, 0.07]])
    np.testing.assert_allclose(mouth.closed(far), far, atol=1e-9)


def test_lips_are_where_the_mouth_is() -> None:
    on = np.array([[0.0, 1.522, 0.095], [0.0, 1.514, 0.097], [0.015, 1.5205, 0.09]])
    off = np.array([[0.0, 1.535, 0.09], [0.0, 1.50, 0.09], [0.035, 1.52, 0.08]])
    assert (mouth.lip_mask(on) < 0).all()
    assert (mouth.lip_mask(off) > 0).all()


def test_the_inside_of_the_mouth_is_told_from_the_lips() -> None:
    wall, lip = np.array([[0.0, 1.536, 0.05]]), np.array([[0.0, 1.514, 0.097]])
    assert mouth.inside_mask(wall)[0] < 0 < mouth.inside_mask(lip)[0]
