"""Signed distances as plain functions of points, of which the character is modelled.

Every primitive takes points (n, 3) in metres and returns distances (n,), negative inside. Distances are exact for
spheres and rounded cones and first-order accurate near the surface for ellipsoids and lofts, which is enough
for meshing, projection and normals. Uses nothing else of the package.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

Points = Float[np.ndarray, "n 3"]
Distances = Float[np.ndarray, " n"]
Field = Callable[[Points], Distances]


def union(*parts: Distances) -> Distances:
    """Sharp union of solids."""
    nearest: Distances = np.minimum.reduce(parts)
    return nearest


def common(*parts: Distances) -> Distances:
    """Sharp intersection of solids."""
    farthest: Distances = np.maximum.reduce(parts)
    return farthest


def smooth_min(a: Distances, b: Distances, k: float) -> Distances:
    """Union whose seam is rounded over about `k` metres (polynomial; not associative, so order matters)."""
    h = np.maximum(k - np.abs(a - b), 0.0) / k
    blend: Distances = union(a, b) - h * h * (k / 4)
    return blend


def smooth_max(a: Distances, b: Distances, k: float) -> Distances:
    """Intersection whose edge is rounded over about `k` metres."""
    return -smooth_min(-a, -b, k)


def carve(solid: Distances, tool: Distances, k: float) -> Distances:
    """`solid` without `tool`, the rim rounded over about `k` metres."""
    return smooth_max(solid, -tool, k)


def mirrored(p: Points) -> Points:
    """Points folded onto the left half (+X): model one side, get both."""
    folded = p.copy()
    folded[:, 0] = np.abs(folded[:, 0])
    return folded


def sphere(p: Points, centre: ArrayLike, radius: float) -> Distances:
    """Distance to a sphere."""
    return _length(p - np.asarray(centre, p.dtype)) - radius


def ellipsoid(p: Points, centre: ArrayLike, radii: ArrayLike, axes: np.ndarray | None = None) -> Distances:
    """First-order distance to an ellipsoid; the rows of `axes` are its own axes in the world."""
    local = p - np.asarray(centre, p.dtype)
    if axes is not None:
        local = local @ axes.T.astype(p.dtype)
    r = np.asarray(radii, p.dtype)
    k0, k1 = _length(local / r), _length(local / (r * r))
    distance: Distances = k0 * (k0 - 1) / np.maximum(k1, 1e-9)
    return distance


def rounded_cone(p: Points, a: ArrayLike, b: ArrayLike, radius_a: float, radius_b: float) -> Distances:
    """Distance to the hull of two spheres, radius interpolated along the segment (near exact for mild tapers)."""
    start, along = np.asarray(a, p.dtype), np.asarray(b, p.dtype) - np.asarray(a, p.dtype)
    local = p - start
    t = np.clip(local @ along / (along @ along), 0, 1)
    distance: Distances = _length(local - t[:, None] * along) - (radius_a + (radius_b - radius_a) * t)
    return distance


def tube(p: Points, path: Sequence[Sequence[float]], k: float) -> Distances:
    """Rounded cones along `path` rows (x, y, z, radius), joined smoothly over `k`."""
    total: Distances | None = None
    for start, end in zip(path[:-1], path[1:], strict=True):
        part = rounded_cone(p, start[:3], end[:3], start[3], end[3])
        total = part if total is None else smooth_min(total, part, k)
    assert total is not None
    return total


def curve(rows: Sequence[Sequence[float]], count: int) -> list[list[float]]:
    """`count` rows along the smooth curve through `rows`; every column, a radius too, is interpolated."""
    from scipy.interpolate import CubicSpline

    table = np.asarray(rows, np.float64)
    steps = np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(steps)])
    bent = CubicSpline(at, table)(np.linspace(0, at[-1], count))
    bent[:, 3] = np.maximum(bent[:, 3], table[:, 3].min())
    smooth: list[list[float]] = bent.tolist()
    return smooth


def draped(p: Points, surface: Distances) -> Points:
    """Points with their depth (z) replaced by their height above a surface: draw in x and y, lie on the surface."""
    flat: Points = np.stack([p[:, 0], p[:, 1], surface], 1)
    return flat


def loft(p: Points, axis: int, stations: Sequence[Sequence[float]]) -> Distances:
    """Ellipses swept along a world axis, ends open (intersect with `slab`).

    `stations` rows: position along the axis, half size and centre on the first other axis, half size and centre on
    the second (other axes in ascending order). Values between stations follow a monotone cubic.
    """
    from scipy.interpolate import PchipInterpolator

    table = np.asarray(stations, np.float64)
    at = np.clip(p[:, axis], table[0, 0], table[-1, 0])
    half_u, centre_u, half_v, centre_v = PchipInterpolator(table[:, 0], table[:, 1:])(at).T.astype(p.dtype)
    u, v = (p[:, i] for i in range(3) if i != axis)
    u, v = u - centre_u, v - centre_v
    k0 = np.sqrt((u / half_u) ** 2 + (v / half_v) ** 2)
    k1 = np.sqrt((u / half_u**2) ** 2 + (v / half_v**2) ** 2)
    distance: Distances = k0 * (k0 - 1) / np.maximum(k1, 1e-9)
    return distance


def rise(x: Distances, low: ArrayLike, high: ArrayLike) -> Distances:
    """0 below `low`, 1 above `high`, smooth in between."""
    t = np.clip((x - low) / (np.asarray(high) - low), 0, 1)
    risen: Distances = t * t * (3 - 2 * t)
    return risen


def slab(p: Points, axis: int, low: float, high: float) -> Distances:
    """Distance to the layer low <= p[axis] <= high."""
    return common(low - p[:, axis], p[:, axis] - high)


def gradient(field: Field, p: Points, step: float = 5e-4) -> Points:
    """Unit gradient by central differences: the outward normal of the nearest surface."""
    offsets = np.eye(3, dtype=p.dtype) * step
    g = np.stack([field(p + offset) - field(p - offset) for offset in offsets], axis=1)
    unit: Points = g / np.maximum(_length(g), 1e-12)[:, None]
    return unit


def project(field: Field, p: Points, passes: int = 3) -> Points:
    """Move points onto the zero surface along the gradient."""
    for _ in range(passes):
        p = p - field(p)[:, None] * gradient(field, p)
    return p


def _length(v: Points) -> Distances:
    length: Distances = np.sqrt(np.einsum("ni,ni->n", v, v))
    return length
