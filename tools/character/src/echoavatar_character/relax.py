"""Better shaped triangles after decimation: flip edges, and slide vertices towards the mean of their neighbours."""

import numpy as np
from jaxtyping import Float, Int

Positions = Float[np.ndarray, "v 3"]
Triangles = Int[np.ndarray, "f 3"]

ROUNDED = 0.98  # least cosine between a vertex's normal and its triangles' at which it slides
SHARP = 0.992  # cosine between two triangles below which their edge is a crease that is kept


def relax(points: Positions, faces: Triangles, *, rounds: int = 4, slide: float = 0.4) -> tuple[Positions, Triangles]:
    """Alternate flips and slides; the outer border and the number of triangles do not change."""
    for _ in range(rounds):
        faces = flipped(points, faces)
        points = slid(points, faces, slide)
    return points, flipped(points, faces)


def slid(points: Positions, faces: Triangles, share: float) -> Positions:
    """Move every vertex by `share` of the way to the mean of its neighbours, along the surface only."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    total, count = np.zeros_like(points), np.zeros(len(points))
    np.add.at(total, edges[:, 0], points[edges[:, 1]])
    np.add.at(count, edges[:, 0], 1)
    way = total / np.maximum(count, 1)[:, None] - points
    normals, flatness = _normals(points, faces)
    way -= np.einsum("vi,vi->v", way, normals)[:, None] * normals
    way *= np.clip((flatness - ROUNDED) / (1 - ROUNDED), 0, 1)[:, None]  # edges keep their vertices
    ordered = np.sort(edges, axis=1)
    _, first, times = np.unique(ordered, axis=0, return_index=True, return_counts=True)
    way[ordered[first[times == 1]].reshape(-1)] = 0  # the border
    way[count == 0] = 0
    moved: Positions = points + share * way
    return moved


def _normals(points: Positions, faces: Triangles) -> tuple[Positions, Float[np.ndarray, " v"]]:
    """Unit normals of the vertices, and the cosine to the triangle around each that leans away most."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normals, flatness = np.zeros_like(points), np.ones(len(points))
    for corner in faces.T:
        np.add.at(normals, corner, face)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    unit = face / np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-30)
    for corner in faces.T:
        np.minimum.at(flatness, corner, np.einsum("fi,fi->f", unit, normals[corner]))
    return normals, flatness


def flipped(points: Positions, faces: Triangles) -> Triangles:
    """Flip edges whose opposite angles add up to more than a half turn (Delaunay); keep creases."""
    triangles = [tuple(face) for face in faces.tolist()]
    owner: dict[tuple[int, int], int] = {}
    for t, (a, b, c) in enumerate(triangles):
        owner[a, b], owner[b, c], owner[c, a] = t, t, t
    place = [np.array(p) for p in points]
    waiting = list(owner)
    while waiting:
        edge = waiting.pop()
        other = edge[::-1]
        if edge not in owner or other not in owner:
            continue
        a, b = edge
        one, two = owner[edge], owner[other]
        c, d = _third(triangles[one], edge), _third(triangles[two], other)
        if c == d or (c, d) in owner or (d, c) in owner or not _should_flip(place, a, b, c, d):
            continue
        del owner[edge], owner[other]
        triangles[one], triangles[two] = (c, d, b), (d, c, a)
        owner[c, d], owner[d, b], owner[b, c] = one, one, one
        owner[d, c], owner[c, a], owner[a, d] = two, two, two
        waiting += [(b, c), (c, a), (a, d), (d, b)]
    return np.asarray(triangles, faces.dtype)


def _third(triangle: tuple[int, ...], edge: tuple[int, int]) -> int:
    return next(v for v in triangle if v not in edge)


def _should_flip(place: list[np.ndarray], a: int, b: int, c: int, d: int) -> bool:
    pa, pb, pc, pd = place[a], place[b], place[c], place[d]
    if _angle(pa - pc, pb - pc) + _angle(pa - pd, pb - pd) <= np.pi + 1e-4:
        return False
    before = _normal(pa, pb, pc), _normal(pb, pa, pd)
    after = _normal(pc, pd, pb), _normal(pd, pc, pa)
    if float(before[0] @ before[1]) < SHARP or float(after[0] @ after[1]) < SHARP:
        return False
    return min(float(n @ m) for n in after for m in before) > 0.5


def _angle(u: np.ndarray, v: np.ndarray) -> float:
    return float(np.arccos(np.clip(u @ v / max(float(np.sqrt((u @ u) * (v @ v))), 1e-30), -1, 1)))


def _normal(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    u, v = b - a, c - a
    n = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    unit: np.ndarray = n / max(float(np.sqrt(n @ n)), 1e-30)
    return unit
