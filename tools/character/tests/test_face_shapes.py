import numpy as np
import pytest

from echoavatar.files.avatar import load_character
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_character.face_points import FacePoints
from echoavatar_character.face_shapes import FACE_NAMES, displacement, turned_normals


def points(part: str = "skin") -> FacePoints:
    """Points all over the front of a head, those of both lips among them."""
    rng = np.random.default_rng(0)
    at = rng.uniform((-0.06, 1.47, 0.04), (0.06, 1.63, 0.10), (400, 3))
    return FacePoints(part, at, np.where(at[:, 1] >= 1.5205, 1.0, -1.0))


def test_names_and_order_are_those_of_the_face_room() -> None:
    assert FACE_NAMES == ARKIT_NAMES
    assert load_character().face.names == ARKIT_NAMES


@pytest.mark.parametrize("name", FACE_NAMES)
def test_every_shape_moves_the_shipped_face_and_by_no_more_than_a_hand_s_width(name: str) -> None:
    face = load_character().face
    length = np.linalg.norm(face.moves[face.part(face.names.index(name))], axis=1)
    assert 0.002 < length.max() < 0.06


@pytest.mark.parametrize("name", [n for n in FACE_NAMES if n.endswith("Left")])
def test_right_shapes_mirror_left_ones(name: str) -> None:
    left = displacement(name, points())
    right = displacement(name.removesuffix("Left") + "Right", points().mirrored())
    np.testing.assert_allclose(right, left * [-1, 1, 1], atol=1e-12)


@pytest.mark.parametrize("name", ["mouthSmile", "mouthLowerDown", "eyeBlink", "browOuterUp", "cheekSquint"])
def test_left_is_the_positive_side(name: str) -> None:
    length = np.linalg.norm(displacement(f"{name}Left", points()), axis=1)
    x = points().at[:, 0]
    assert length[x > 0].sum() > 6 * length[x < 0].sum()


@pytest.mark.parametrize("name", ["jawOpen", "mouthSmileLeft", "eyeBlinkLeft", "mouthPucker", "cheekPuff"])
def test_normals_follow_the_surface(name: str) -> None:
    """Against the cross product of two short tangents carried along by the shape."""
    f = points()
    normals = np.tile([0.0, 0.0, 1.0], (len(f.at), 1))
    step = 1e-6
    moved = [
        f.at + offset + displacement(name, f._replace(at=f.at + offset))
        for offset in ([0, 0, 0], [step, 0, 0], [0, step, 0])
    ]
    cross = np.cross(moved[1] - moved[0], moved[2] - moved[0])
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    agree = np.einsum("ni,ni->n", cross, turned_normals(name, f, normals))
    assert np.quantile(agree, 0.05) > 0.99
