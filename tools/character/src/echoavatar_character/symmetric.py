"""Meshes that are exactly symmetric about x = 0, with more triangles in a close-up region."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from .relax import relax
from .sculpt import Mesh, mesh_of, outward
from .sdf import Field, Points, gradient, project

SNAP = 0.0004  # metres: vertices nearer to the middle are moved onto it


class CloseUp(NamedTuple):
    """A ball that gets more triangles: its space is enlarged `power` times during decimation."""

    centre: tuple[float, float, float]
    radius: float
    power: float


def sculpt_symmetric(
    field: Field, low: ArrayLike, high: ArrayLike, *, cell: float, triangles: int, closeups: Sequence[CloseUp] = ()
) -> Mesh:
    """Mesh the zero surface of a field that is even in x; `triangles` counts both halves."""
    low, high = np.asarray(low, np.float64).copy(), np.asarray(high, np.float64)
    low[0] = -10 * cell
    mesh = mesh_of(
        field,
        low,
        high,
        cell=cell,
        triangles=triangles // 2,
        enlarge=_chain([_enlarged(c) for c in closeups]),
        shrink=_chain([_shrunk(c) for c in reversed(closeups)]),
        tidy=relax,
    )
    points = mesh.positions.astype(np.float64)
    points[np.abs(points[:, 0]) < SNAP, 0] = 0
    points, faces = _cut(points, mesh.triangles)
    middle = points[:, 0] == 0
    points = project(field, points)
    points[middle, 0] = 0
    normals = gradient(field, points)
    half = Mesh(points, normals, outward(points, normals, faces))
    return _doubled(half, middle)


def _cut(points: Points, faces: Int[np.ndarray, "f 3"]) -> tuple[Points, Int[np.ndarray, "f 3"]]:
    """The half x >= 0; triangles across the middle are split there."""
    whole = (points[faces, 0] >= 0).all(1)
    across = ~whole & (points[faces, 0] > 0).any(1)
    made: dict[tuple[int, int], int] = {}
    extra: list[np.ndarray] = []

    def crossing(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in made:
            made[key] = len(points) + len(extra)
            t = points[a, 0] / (points[a, 0] - points[b, 0])
            extra.append((points[a] + t * (points[b] - points[a])) * (0, 1, 1))
        return made[key]

    pieces: list[tuple[int, int, int]] = []
    for face in faces[across].tolist():
        ring: list[int] = []
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            if points[a, 0] >= 0:
                ring.append(a)
            if points[a, 0] * points[b, 0] < 0:
                ring.append(crossing(a, b))
        pieces += [(ring[0], ring[i], ring[i + 1]) for i in range(1, len(ring) - 1)]
    kept = np.concatenate([faces[whole], np.asarray(pieces, faces.dtype).reshape(-1, 3)])
    used, compact = np.unique(kept, return_inverse=True)
    return np.concatenate([points, *(e[None] for e in extra)])[used], compact.reshape(-1, 3).astype(np.int32)


def _doubled(half: Mesh, middle: Int[np.ndarray, " v"]) -> Mesh:
    """Both halves, welded along the middle; right vertices follow the left ones in the same order."""
    count, own = len(half.positions), np.flatnonzero(~middle)
    twin = np.arange(count)
    twin[own] = count + np.arange(len(own))
    flip = np.array([-1.0, 1.0, 1.0])
    normals = half.normals.copy()
    normals[middle, 0] = 0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        np.concatenate([half.positions, half.positions[own] * flip]).astype(np.float32),
        np.concatenate([normals, normals[own] * flip]).astype(np.float32),
        np.concatenate([half.triangles, twin[half.triangles][:, ::-1]]).astype(np.int32),
    )


Map = Callable[[Points], Points]


def _chain(maps: Sequence[Map]) -> Map:
    def all_of(p: Points) -> Points:
        for one in maps:
            p = one(p)
        return p

    return all_of


def _enlarged(close: CloseUp) -> Map:
    return lambda p: _radial(p, close, *_scale(close))


def _shrunk(close: CloseUp) -> Map:
    return lambda p: _radial(p, close, *_scale(close)[::-1])


def _scale(close: CloseUp) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Distances from the centre and their images: `power` times as large up to the radius, then with slope 1."""
    r = np.linspace(0, 12 * close.radius, 1200)
    pace = 1 + (close.power - 1) / (1 + (r / close.radius) ** 6)
    return r, np.concatenate([[0], np.cumsum((pace[1:] + pace[:-1]) / 2 * np.diff(r))])


def _radial(p: Points, close: CloseUp, old: np.ndarray, new: np.ndarray) -> Points:
    away = p - np.asarray(close.centre)
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    moved = np.interp(distance, old, new) + np.maximum(distance - old[-1], 0)
    changed: Points = np.asarray(close.centre) + away * (moved / distance)[:, None]
    return changed
