"""From signed distances to light triangle meshes: sparse sampling, marching cubes, decimation, projection."""

from collections.abc import Callable
from typing import NamedTuple

import fast_simplification
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from skimage.measure import marching_cubes

from .sdf import Field, Points, gradient, project

Triangles = Int[np.ndarray, "f 3"]
BLOCK = 6  # cells along the edge of a block: only blocks near the surface are sampled finely


class Mesh(NamedTuple):
    """Positions in metres, unit normals, and counter-clockwise triangles."""

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "f 3"]


def sculpt(field: Field, low: ArrayLike, high: ArrayLike, *, cell: float, triangles: int) -> Mesh:
    """Mesh the zero surface of `field` in the box low..high at `cell` metres, decimated to about `triangles`.

    The surface must close inside the box. Vertices lie on the surface, normals are the field's gradient.
    """
    return mesh_of(field, low, high, cell=cell, triangles=triangles, enlarge=_same, shrink=_same, tidy=_untouched)


def mesh_of(
    field: Field,
    low: ArrayLike,
    high: ArrayLike,
    *,
    cell: float,
    triangles: int,
    enlarge: Callable[[Points], Points],
    shrink: Callable[[Points], Points],
    tidy: Callable[[Points, Triangles], tuple[Points, Triangles]],
) -> Mesh:
    """`sculpt`, with decimation and `tidy` in the space after `enlarge`; `shrink` is its inverse."""
    origin, volume = sample(field, np.asarray(low, np.float32), np.asarray(high, np.float32), cell)
    points, faces, _, _ = marching_cubes(volume, 0.0, spacing=(cell,) * 3)
    points = enlarge((points + origin).astype(np.float64)).astype(np.float32)
    share = min(1.0, triangles / len(faces))
    if share < 1:
        points, faces = fast_simplification.simplify(points, faces.astype(np.int32), 1 - share, agg=3)
    points, faces = tidy(np.asarray(points, np.float64), faces)
    points = project(field, shrink(points))
    normals = gradient(field, points)
    return Mesh(points.astype(np.float32), normals.astype(np.float32), outward(points, normals, faces))


def _same(p: Points) -> Points:
    return p


def _untouched(p: Points, faces: Triangles) -> tuple[Points, Triangles]:
    return p, faces


def sample(
    field: Field, low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"], cell: float
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "x y z"]]:
    """Grid origin and distances on a dense grid; far from the surface only block centres are evaluated."""
    blocks = np.ceil((high - low) / (cell * BLOCK)).astype(int)
    centres = np.stack(np.meshgrid(*(np.arange(n) for n in blocks), indexing="ij"), -1).reshape(-1, 3)
    middle = (low + (centres + 0.5) * BLOCK * cell - 0.5 * cell).astype(np.float32)
    coarse = field(middle)
    volume = np.repeat(np.repeat(np.repeat(coarse.reshape(blocks), BLOCK, 0), BLOCK, 1), BLOCK, 2)
    near = np.flatnonzero(np.abs(coarse) < 1.6 * BLOCK * cell)
    local = np.stack(np.meshgrid(*(np.arange(BLOCK),) * 3, indexing="ij"), -1).reshape(-1, 3)
    for chosen in np.array_split(near, max(1, len(near) * len(local) // 400_000)):
        index = (centres[chosen][:, None] * BLOCK + local).reshape(-1, 3)
        volume[tuple(index.T)] = field((low + index * cell).astype(np.float32))
    return low, volume.astype(np.float32)


def outward(
    points: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Int[np.ndarray, "f 3"]:
    """Wind triangles so that they face along the normals; drop triangles without area."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    agrees = np.einsum("fi,fi->f", face, normals[faces].sum(1))
    faces = np.where((agrees < 0)[:, None], faces[:, ::-1], faces)
    kept: Int[np.ndarray, "f 3"] = faces[np.linalg.norm(face, axis=1) > 1e-10].astype(np.int32)
    return kept
