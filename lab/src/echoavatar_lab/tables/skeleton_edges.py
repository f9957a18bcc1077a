"""Bones as the edges of a graph: which of them a skeleton convolution mixes, and how it merges them.

Edge 0 is virtual: it is attached to the root and carries the root's own rotation. Edge j is the bone from the parent of
joint j to joint j. Edges and joints thus have the same numbers, and a frame's rotations are the edges' channels.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

Edge = tuple[int, int]

SMPLX_PARENTS = (
    (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15)
    + tuple(parent for first in range(25, 40, 3) for parent in (20, first, first + 1))
    + tuple(parent for first in range(40, 55, 3) for parent in (21, first, first + 1))
)
"""Parents of SMPL-X's 55 joints: body, jaw and eyes, left fingers, right fingers."""


def skeleton_edges(parents: Sequence[int]) -> list[Edge]:
    """All bones of a skeleton whose joint 0 is the root; the virtual edge comes first."""
    return [(0, len(parents)), *((parents[joint], joint) for joint in range(1, len(parents)))]


def neighbours(edges: Sequence[Edge], reach: int) -> Bool[np.ndarray, "e e"]:
    """Which edges are at most `reach` apart; edges that share a joint are 1 apart."""
    ends = np.array(edges)
    touching = (ends[:, None, :, None] == ends[None, :, None, :]).any((2, 3))
    near = np.eye(len(edges), dtype=bool)
    for _ in range(reach):
        near = (near.astype(int) @ touching.astype(int)) > 0
    return near


def merged(edges: Sequence[Edge]) -> tuple[list[list[int]], list[Edge]]:
    """Groups of one or two edges to merge, and the merged edges.

    Unbranched chains of bones are paired from their far end; in an odd chain the first bone stays alone. The virtual
    edge comes first and stays as it is; the order is depth first from the root.
    """
    leaving: dict[int, list[int]] = {}
    for index, (start, _) in enumerate(edges):
        if index:
            leaving.setdefault(start, []).append(index)
    groups = [[0]]

    def walk(first: int) -> None:
        chain = [first]
        while len(after := leaving.get(edges[chain[-1]][1], [])) == 1:
            chain.append(after[0])
        odd = len(chain) % 2
        groups.extend([[chain[0]]] if odd else [])
        groups.extend([chain[k], chain[k + 1]] for k in range(odd, len(chain), 2))
        for branch in after:
            walk(branch)

    for edge in leaving.get(0, []):
        walk(edge)
    return groups, [(edges[group[0]][0], edges[group[-1]][1]) for group in groups]


def averaging(groups: Sequence[Sequence[int]], edges: int, channels: int) -> Float[np.ndarray, "out in"]:
    """Matrix that averages the channels over each group of edges."""
    matrix = np.zeros((len(groups), edges), np.float32)
    for row, group in enumerate(groups):
        matrix[row, list(group)] = 1 / len(group)
    return np.kron(matrix, np.eye(channels, dtype=np.float32))
