import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial import cKDTree

from echoavatar_character import clothes
from echoavatar_character.base import load_base
from echoavatar_character.body import Body, make_body
from echoavatar_character.fit import NAMES
from echoavatar_character.person import PEOPLE
from echoavatar_character.shoes import shoes
from echoavatar_character.surface import Surface, normals

Points = Float[np.ndarray, "n d"]


def test_clothes_lie_outside_the_body_and_have_closed_hems(body: Body, whole: Surface) -> None:
    """Nearly all cloth is on the outer side of the nearest skin."""
    out = normals(whole.positions, whole.quads)
    cloth = clothes.tights(body)
    for piece in (clothes.top(body, cloth), clothes.trousers(cloth, shoes(body, cloth))):
        near = cKDTree(whole.positions).query(piece.positions)[1]
        height = np.einsum("vi,vi->v", piece.positions - whole.positions[near], out[near])
        assert (height > -0.004).mean() > 0.92


@pytest.mark.parametrize("name", PEOPLE)
def test_a_sleeve_is_no_wider_than_the_arm_by_more_than_three_centimetres(body: Body, name: str) -> None:
    own = make_body(PEOPLE[name])
    top, skin = clothes.top(own, clothes.tights(own)), load_base().vertices_of("body")
    points, weights = own.points[skin], own.weights[skin]
    for first, last in (("leftUpperArm", "leftLowerArm"), ("leftLowerArm", "leftHand")):
        for share in (0.42, 0.5, 0.65, 0.8):  # further up the armpit begins
            sleeve = _girth(top.positions, top.weights, own, first, last, share)
            arm = _girth(points, weights, own, first, last, share)
            assert 0 < sleeve - arm < 0.03, (first, share, sleeve, arm)


def _girth(points: Points, weights: Points, body: Body, first: str, last: str, share: float) -> float:
    """The widest diameter of an arm's outline at a place between two joints, in metres."""
    start, end = body.joint(first), body.joint(last)
    along = (end - start) / np.linalg.norm(end - start)
    rel = points - (start + (end - start) * share)
    own = weights[:, [NAMES.index("leftUpperArm"), NAMES.index("leftLowerArm"), NAMES.index("leftHand")]].sum(1) > 0.7
    ring = rel[own & (np.abs(rel @ along) < 0.02)]
    side = np.cross(along, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    flat = np.stack([ring @ side, ring @ np.cross(along, side)], 1)
    turns = np.linspace(0, np.pi, 24, endpoint=False)
    return float(np.ptp(flat @ np.stack([np.cos(turns), np.sin(turns)]), axis=0).max())


def test_a_tucked_top_is_inside_the_waistband_and_trousers_are_inside_a_jacket(body: Body) -> None:
    cloth = clothes.tights(body)
    top = clothes.top(body, cloth)
    legs = clothes.trousers(cloth, shoes(body, cloth))
    below = (top.positions[:, 1] < clothes.HEM + 0.012) & (np.abs(top.positions[:, 0]) < 0.2)
    inner = clothes.tucked(top, legs, upwards=False)
    assert _apart(inner.positions[below], legs.positions) < -0.004
    above = legs.positions[:, 1] > clothes.HEM
    inner = clothes.tucked(legs, top, upwards=True)
    assert _apart(inner.positions[above], top.positions) < -0.004


def _apart(inner: Points, over: Points) -> float:
    """How far the outermost of inner points lies outside of others at its height and direction, in metres."""
    middle = np.array([0, 0, -0.005])
    flat = (inner - middle) * [1, 0, 1]
    out = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    near = cKDTree(over).query(inner)[1]
    return float(np.percentile(((inner - over[near]) * out).sum(1), 98))


def test_a_shirt_falls_straight_from_the_chest_to_the_belt(body: Body) -> None:
    """No fold below the chest and no belly: over 14 cm its front keeps within 6 mm of a line."""
    own = make_body(PEOPLE["theo"])
    points = clothes.top(own, clothes.tights(own)).positions
    low, high = clothes.HEM + 0.075, clothes.CHEST[0]
    front = (np.abs(points[:, 0]) < 0.08) & (points[:, 2] > 0.05) & (points[:, 1] > low) & (points[:, 1] < high)
    table = np.stack([points[front, 1], points[front, 0] ** 2, np.ones(front.sum())], 1)
    away = points[front, 2] - table @ np.linalg.lstsq(table, points[front, 2], rcond=None)[0]
    assert np.abs(away).max() < 0.006


def test_shoulders_fall_from_the_neck_outwards(body: Body) -> None:
    points = clothes.top(body, clothes.tights(body)).positions
    inner, outer = (points[np.abs(points[:, 0] - x) < 0.01, 1].max() for x in (0.09, 0.17))
    assert inner > outer + 0.015
