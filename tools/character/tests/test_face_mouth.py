import numpy as np
import pytest

from echoavatar_character import face_mouth as mouth
from echoavatar_character.face_points import FacePoints
from echoavatar_character.figure_mouth import ARCH, WIDE, line


def seam(side: float) -> FacePoints:
    """Points where the lips meet, as those of one lip."""
    x = np.linspace(-0.95 * WIDE, 0.95 * WIDE, 21)
    return FacePoints("skin", np.stack([x, line(x), 0.093 - ARCH * x**2], 1), np.full(21, side))


def test_the_open_mouth_is_open_and_closes_again() -> None:
    """At the jaw's widest the lips part by over 2 cm; `mouth_close` at the same strength brings them together."""
    upper, lower = seam(1.0), seam(-1.0)
    gap = mouth.jaw_open(upper)[:, 1] - mouth.jaw_open(lower)[:, 1]
    assert gap[10] > 0.02
    assert gap[[0, -1]].max() < 0.6 * gap[10]  # an oval
    closed = [mouth.jaw_open(f) + mouth.mouth_close(f) for f in (upper, lower)]
    np.testing.assert_allclose(closed[0], closed[1], atol=5e-5)


SEALED = (
    mouth.pucker, mouth.mouth_left, mouth.smile, mouth.frown, mouth.dimple, mouth.stretch, mouth.press,
    mouth.shrug_lower, mouth.shrug_upper, mouth.cheek_puff,
)  # fmt: skip


@pytest.mark.parametrize("shape", SEALED)
def test_lips_that_stay_closed_do_not_cross(shape) -> None:  # type: ignore[no-untyped-def]
    np.testing.assert_allclose(shape(seam(1.0))[:, 1], shape(seam(-1.0))[:, 1], atol=2e-4)


@pytest.mark.parametrize("shape", [mouth.funnel, mouth.lower_down, mouth.upper_up, mouth.tongue_out, mouth.jaw_open])
def test_lips_that_part_do_so_the_right_way(shape) -> None:  # type: ignore[no-untyped-def]
    gap = shape(seam(1.0))[:, 1] - shape(seam(-1.0))[:, 1]
    assert gap.min() > -1e-6
    assert gap.max() > 0.002


def test_teeth_and_tongue_ride_with_the_jaw() -> None:
    at = np.array([[0.0, 1.512, 0.075], [0.01, 1.515, 0.07]])
    drop = {
        part: mouth.jaw_open(FacePoints(part, at, np.ones(2)))[:, 1].max()
        for part in ("upper teeth", "lower teeth", "tongue", "left eye", "brows")
    }
    assert drop["upper teeth"] == drop["left eye"] == drop["brows"] == 0
    assert drop["lower teeth"] < -0.015
    assert drop["tongue"] == drop["lower teeth"]


def test_the_tongue_comes_out_through_the_parted_lips() -> None:
    tip = FacePoints("tongue", np.array([[0.0, 1.509, 0.076]]), np.ones(1))
    out = tip.at + mouth.tongue_out(tip)
    assert out[0, 2] > 0.105
    upper, lower = seam(1.0), seam(-1.0)
    top = (upper.at + mouth.tongue_out(upper))[10, 1]
    bottom = (lower.at + mouth.tongue_out(lower))[10, 1]
    assert bottom < out[0, 1] + 0.004 < top + 0.004


def test_the_mouth_does_not_move_the_back_of_the_head() -> None:
    at = np.random.default_rng(0).uniform((-0.05, 1.45, -0.10), (0.05, 1.65, -0.02), (200, 3))
    f = FacePoints("skin", at, np.where(at[:, 1] > 1.52, 1.0, -1.0))
    for shape in (*SEALED, mouth.jaw_open, mouth.mouth_close, mouth.funnel, mouth.jaw_left, mouth.nose_sneer):
        assert np.abs(shape(f)).max() < 2e-4
