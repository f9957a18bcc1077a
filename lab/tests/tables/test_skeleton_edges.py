import numpy as np

from echoavatar_lab.tables.skeleton_edges import SMPLX_PARENTS, averaging, merged, neighbours, skeleton_edges

# a root with a chain of three bones, the last of which branches into two
PARENTS = (-1, 0, 1, 2, 3, 3)


def test_edges_are_numbered_like_joints() -> None:
    assert skeleton_edges(PARENTS) == [(0, 6), (0, 1), (1, 2), (2, 3), (3, 4), (3, 5)]
    assert len(skeleton_edges(SMPLX_PARENTS)) == 55


def test_neighbours_are_counted_along_the_bones() -> None:
    edges = skeleton_edges(PARENTS)
    assert np.flatnonzero(neighbours(edges, 0)[1]).tolist() == [1]
    assert np.flatnonzero(neighbours(edges, 1)[1]).tolist() == [0, 1, 2]
    assert np.flatnonzero(neighbours(edges, 2)[1]).tolist() == [0, 1, 2, 3]
    assert np.flatnonzero(neighbours(edges, 1)[4]).tolist() == [3, 4, 5]


def test_chains_merge_in_pairs_from_their_far_end() -> None:
    """Three bones: the first stays alone. Branches end chains."""
    groups, left = merged(skeleton_edges(PARENTS))
    assert groups == [[0], [1], [2, 3], [4], [5]]
    assert left == [(0, 6), (0, 1), (1, 3), (3, 4), (3, 5)]


def test_averaging_takes_means_channel_by_channel() -> None:
    matrix = averaging([[0], [1, 2]], 3, 2)
    np.testing.assert_allclose(matrix @ np.array([1.0, 2, 3, 4, 5, 6]), [1, 2, 4, 5])
