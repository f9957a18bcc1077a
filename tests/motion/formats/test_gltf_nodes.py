"""The tree of a glTF's nodes, and what their matrices say."""

import numpy as np
import pytest

from echoavatar.limits import DEPTH, NODES
from echoavatar.motion.formats.gltf_nodes import (
    above,
    node_matrix,
    parents_of,
    rotation_of,
    scale_of,
    unscaled,
    worlds_of,
)

HALF = np.sqrt(0.5)
QUARTER_Z = [0.0, 0.0, HALF, HALF]  # xyzw: X becomes Y


def test_parents_come_before_children_wherever_the_file_lists_them() -> None:
    parents = parents_of([{}, {"children": [0]}, {"children": [1, 3]}, {}])
    assert parents == {0: 1, 1: 2, 2: -1, 3: 2}
    order = list(parents)
    assert all(order.index(parent) < order.index(node) for node, parent in parents.items() if parent >= 0)
    assert above(parents, 0) == [1, 2]


@pytest.mark.parametrize(
    ("nodes", "complaint"),
    [
        ([{"children": [1]}, {}, {"children": [1]}], "two parents"),
        ([{}, {"children": [2]}, {"children": [1]}], "its own parents"),
        ([*({"children": [k + 1]} for k in range(DEPTH + 1)), {}], "deep"),
        ([{}] * (NODES + 1), "at most"),
    ],
    ids=["two parents", "a ring", "deep", "many"],
)
def test_a_tree_that_is_none_is_refused(nodes: list[dict], complaint: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(ValueError, match=complaint):
        parents_of(nodes)


def test_a_matrix_and_its_parts_are_the_same_node() -> None:
    parts = {"translation": [1.0, 2, 3], "rotation": QUARTER_Z, "scale": [2.0, 3, 4]}
    matrix = node_matrix(parts)
    np.testing.assert_allclose(matrix @ [1, 0, 0, 1], [1, 4, 3, 1], atol=1e-12)
    whole = {"matrix": matrix.T.reshape(-1).tolist()}
    for node in (parts, whole):
        np.testing.assert_allclose(node_matrix(node), matrix, atol=1e-12)
        np.testing.assert_allclose(scale_of(node), [2, 3, 4], atol=1e-12)
        np.testing.assert_allclose(rotation_of(node), QUARTER_Z, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_the_parts_of_a_mirrored_matrix_make_it_again(axis: int) -> None:
    matrix = node_matrix({"rotation": QUARTER_Z, "scale": [2.0, 2, 2]})
    matrix[:, axis] *= -1
    node = {"matrix": matrix.T.reshape(-1).tolist()}
    again = {"rotation": rotation_of(node).tolist(), "scale": scale_of(node).tolist()}
    np.testing.assert_allclose(node_matrix(again), matrix, atol=1e-12)
    assert np.linalg.det(unscaled(matrix)) == pytest.approx(-1)


def test_worlds_follow_the_tree() -> None:
    nodes = [{"translation": [1.0, 0, 0]}, {"children": [0], "rotation": QUARTER_Z, "scale": [2.0, 2, 2]}]
    worlds = worlds_of({node: node_matrix(entry) for node, entry in enumerate(nodes)}, parents_of(nodes))
    np.testing.assert_allclose(worlds[0][:3, 3], [0, 2, 0], atol=1e-12)
