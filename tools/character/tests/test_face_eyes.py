import numpy as np
import pytest

from echoavatar_character import face_eyes as eyes
from echoavatar_character.face_points import FacePoints
from echoavatar_character.figure_eyes import EYE, EYE_RADIUS, LID, LID_WIDTH, lower_rim, upper_rim


def rims() -> tuple[FacePoints, FacePoints]:
    """Points along the edges of the upper and the lower left lid."""
    x = np.linspace(-0.9, 0.9, 19)

    def edge(height: np.ndarray) -> FacePoints:
        rim = EYE_RADIUS + 0.6 * LID
        depth = np.sqrt(rim**2 - (x * LID_WIDTH) ** 2 - height**2)
        return FacePoints("skin", EYE + np.stack([x * LID_WIDTH, height, depth], 1), np.ones(19))

    return edge(upper_rim(x) + 1e-4), edge(lower_rim(x) - 1e-4)


def test_a_blink_closes_the_eye() -> None:
    upper, lower = rims()
    gap = (upper.at + eyes.blink(upper) - lower.at - eyes.blink(lower))[:, 1]
    np.testing.assert_allclose(gap, 0, atol=6e-4)


@pytest.mark.parametrize("strength", [0.25, 0.5, 0.75, 1.0])
@pytest.mark.parametrize("shape", [eyes.blink, eyes.squint, eyes.wide, eyes.cheek_squint])
def test_lids_never_sink_into_the_eyeball(shape, strength: float) -> None:  # type: ignore[no-untyped-def]
    """Half way through, a lid goes straight where it should go round: its outside must still cover the eye."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(4000, 3))
    way[:, 2] = np.abs(way[:, 2])
    at = EYE + way / np.linalg.norm(way, axis=1, keepdims=True) * (EYE_RADIUS + LID)
    f = FacePoints("skin", at, np.ones(4000))
    local = at - EYE
    x = np.clip(local[:, 0] / LID_WIDTH, -1, 1)
    outside = (local[:, 1] > upper_rim(x) + 0.0012) | (local[:, 1] < lower_rim(x) - 0.0012)
    radius = np.linalg.norm(local + strength * shape(f), axis=1)
    assert radius[outside].min() > EYE_RADIUS + 0.0002


def test_eyes_turn_where_the_names_say() -> None:
    """Looking out, the left eye's front goes to +X (the character's left); up is up."""
    front = FacePoints("left eye", (EYE + (0, 0, EYE_RADIUS))[None], np.ones(1))
    assert eyes.look(front, out=1)[0, 0] > 0.005
    assert eyes.look(front, out=-1)[0, 0] < -0.005
    assert eyes.look(front, up=1)[0, 1] > 0.005
    assert eyes.look(front, up=-1)[0, 1] < -0.005


def test_the_upper_lid_follows_a_look_down() -> None:
    upper, _ = rims()
    assert eyes.look(upper, up=-1)[9, 1] < -0.002
    assert eyes.look(upper, up=1)[9, 1] > 0.0005


def test_brows_go_up_and_down_and_leave_the_lids() -> None:
    brow = FacePoints("brows", np.array([[0.016, 1.611, 0.088], [0.042, 1.613, 0.078]]), np.ones(2))
    assert eyes.brow_inner_up(brow)[0, 1] > 0.004 > eyes.brow_inner_up(brow)[1, 1]
    assert eyes.brow_outer_up(brow)[1, 1] > 0.004 > eyes.brow_outer_up(brow)[0, 1]
    assert eyes.brow_down(brow)[:, 1].max() < -0.002
    for shape in (eyes.brow_down, eyes.brow_inner_up, eyes.brow_outer_up):
        assert np.abs(shape(rims()[0])).max() < 1e-3
