import numpy as np

from echoavatar_character.hair import APART, AXIS, STRIPS, _gathered, paint_hair
from echoavatar_character.person import PEOPLE


def test_strands_are_dense_at_the_root_and_part_at_the_tip() -> None:
    picture = paint_hair(PEOPLE["maya"], 256)
    opaque = picture[..., 3] > 0.5
    assert opaque[60:120].mean() > 0.5
    assert opaque[-8:].mean() < 0.5 * opaque[60:120].mean()
    for strip in range(STRIPS):
        assert opaque[:, strip * 64 : strip * 64 + 64].mean() > 0.2


def test_a_ribbon_that_hangs_apart_is_brought_to_those_beside_it() -> None:
    lines = np.stack([np.full((9, 5), 0.08), np.tile(np.linspace(-0.02, -0.07, 5), (9, 1)), np.full((9, 5), AXIS)], -1)
    lines[4, :, 0] = 0.12
    made = _gathered(lines)
    np.testing.assert_allclose(made[:4], lines[:4])
    assert made[4, :, 0].max() < 0.08 + APART + 1e-6
