"""From the parts of a face to its morph targets: the modelled head with closed lips, and its 52 shapes."""

from collections.abc import Sequence

import numpy as np

from echoavatar.files.avatar.morphs import Morphs

from . import figure_mouth as mouth
from .face_points import FacePoints, Shares
from .face_shapes import FACE_NAMES, displacement, turned_normals
from .sculpt import Mesh

STEP = 2e-4  # metres, the finite difference from which normals are computed


def neutral(modelled: Mesh) -> tuple[Mesh, Shares]:
    """Close the lips of the modelled head; also return the lip that each vertex belongs to (`figure_mouth.above`)."""
    points = modelled.positions.astype(np.float64)
    side = mouth.above(points)
    columns = [
        (mouth.closed(points + STEP * axis, side) - mouth.closed(points - STEP * axis, side)) / (2 * STEP)
        for axis in np.eye(3)
    ]
    x, y, z = columns
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    normals = np.einsum("nij,nj->ni", cofactors, modelled.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    closed = Mesh(mouth.closed(points, side).astype(np.float32), normals.astype(np.float32), modelled.triangles)
    return closed, side


def face_morphs(parts: Sequence[tuple[str, Mesh, Shares]]) -> Morphs:
    """All shapes for the vertices of the parts, in the order of the parts."""
    moves, turns = [], []
    for name in FACE_NAMES:
        some_moves, some_turns = [], []
        for part, mesh, side in parts:
            points = FacePoints(part, mesh.positions.astype(np.float64), side)
            normals = mesh.normals.astype(np.float64)
            moved = displacement(name, points)
            turned = turned_normals(name, points, normals) - normals
            some_moves.append(moved)
            some_turns.append(turned * (np.abs(moved).max(1, keepdims=True) > 1e-6))
        moves.append(np.concatenate(some_moves))
        turns.append(np.concatenate(some_turns))
    return Morphs.of_dense(FACE_NAMES, np.stack(moves), np.stack(turns))
