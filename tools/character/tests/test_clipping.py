"""No part of a person passes through another in the twenty extreme poses: no edge of one crosses a triangle of another.

Counted are trousers, jumper (trunk and forearms with hands), hair and head. Parts that grow out of one another, such as
upper arms and trunk, and what is hidden inside collars, cuffs and shoes are not.
"""

import numpy as np
import pytest
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from echoavatar.files.avatar import CHARACTERS, MATERIALS, Character, load_character
from echoavatar.files.avatar.halfway import BONES
from echoavatar_character.pose import posed
from echoavatar_character.sheets import POSES
from echoavatar_character.stored import bone_weights

BELOW_ELBOW = ("LowerArm", "Hand", "Thumb", "Index", "Middle", "Ring", "Little")
PAIRS = [("trousers", "trunk"), ("hair", "trunk"), ("left forearm", "right forearm")]
PAIRS += [(f"{side} forearm", part) for side in ("left", "right") for part in ("trousers", "trunk", "head", "hair")]


def _parts(character: Character) -> dict[str, Bool[np.ndarray, " v"]]:
    of = {material.name: character.materials == i for i, material in enumerate(MATERIALS)}
    weights = bone_weights(character)

    def share(*names: str, side: str = "") -> Float[np.ndarray, " v"]:
        columns = [i for i, bone in enumerate(BONES) if bone.startswith(side) and any(name in bone for name in names)]
        return np.asarray(weights[:, columns].sum(1))

    trunk = of["cloth"] & (share("UpperArm", *BELOW_ELBOW) < 0.02)
    forearms = {f"{side} forearm": share(*BELOW_ELBOW, side=side) > 0.9 for side in ("left", "right")}
    head = of["skin"] & (share("head") > 0.5)
    return {"trousers": of["trousers"], "hair": of["hair"], "trunk": trunk, "head": head, **forearms}


def _edges(triangles: Int[np.ndarray, "a 3"]) -> Int[np.ndarray, "e 2"]:
    return np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)


def _meets(some: Float[np.ndarray, "n k 3"], others: Float[np.ndarray, "m l 3"]) -> Bool[np.ndarray, " n"]:
    """Which of them reach into the box around all others."""
    low, high = others.min((0, 1)), others.max((0, 1))
    return np.asarray(((some.max(1) >= low) & (some.min(1) <= high)).all(1))


def _crossings(points: Float[np.ndarray, "v 3"], edges: Int[np.ndarray, "e 2"], faces: Int[np.ndarray, "b 3"]) -> int:
    """How many pairs there are of an edge and a triangle that it crosses."""
    ends, corners = points[edges], points[faces]
    ends, corners = ends[_meets(ends, corners)], corners[_meets(corners, ends)]
    if not len(ends) or not len(corners):
        return 0
    middle, centre = ends.mean(1), corners.mean(1)
    reach = (
        np.linalg.norm(ends - middle[:, None], axis=2).max() + np.linalg.norm(corners - centre[:, None], axis=2).max()
    )
    close = cKDTree(middle).sparse_distance_matrix(cKDTree(centre), reach, output_type="ndarray")
    (start, end), (a, b, c) = ends[close["i"]].transpose(1, 0, 2), corners[close["j"]].transpose(1, 0, 2)
    across, along = np.cross(b - a, c - a), end - start
    with np.errstate(divide="ignore", invalid="ignore"):  # an edge along the triangle's plane does not cross it
        at = ((a - start) * across).sum(1) / (along * across).sum(1)
        place = start + at[:, None] * along
        inside = [(np.cross(q - p, place - p) * across).sum(1) > 0 for p, q in ((a, b), (b, c), (c, a))]
    return int(((at > 0) & (at < 1) & np.all(inside, axis=0)).sum())


def test_an_edge_through_a_triangle_is_a_crossing_and_one_beside_it_is_none() -> None:
    flat = np.float64([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    upright = np.float64([[0.2, 0.2, -1], [0.2, 0.2, 1], [3, 3, 3]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert _crossings(np.concatenate([flat, upright]), _edges(faces[1:]), faces[:1]) == 1
    assert _crossings(np.concatenate([flat, upright + [0.7, 0.7, 0]]), _edges(faces[1:]), faces[:1]) == 0


@pytest.mark.parametrize("name", CHARACTERS)
def test_nothing_passes_through_anything_in_twenty_extreme_poses(name: str) -> None:
    character = load_character(name)
    faces = {part: character.triangles[mine[character.triangles].all(1)] for part, mine in _parts(character).items()}
    assert all(len(each) for each in faces.values())
    edges, found = {part: _edges(mine) for part, mine in faces.items()}, {}
    for number, turns in enumerate(POSES, 1):
        points = posed(character, turns)[0].astype(float)
        for one, other in PAIRS:
            count = _crossings(points, edges[one], faces[other]) + _crossings(points, edges[other], faces[one])
            if count:
                found[number, one, other] = count
    assert not found
