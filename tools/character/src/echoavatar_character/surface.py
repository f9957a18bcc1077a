"""Surfaces on the way to the finished mesh: quads with UVs and skin weights, and what is done to them."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array


@dataclass(frozen=True)
class Surface:
    """Quads (a triangle repeats its last corner) in the modelled pose.

    `moves` are the face's curves at 1; `colours` is a linear factor on the material's colour.
    """

    positions: Float[np.ndarray, "v 3"]
    quads: Int[np.ndarray, "f 4"]
    uvs: Float[np.ndarray, "f 4 2"]
    weights: Float[np.ndarray, "v j"]
    material: str
    colours: Float[np.ndarray, "v 3"]
    moves: dict[str, Float[np.ndarray, "v 3"]] = field(default_factory=dict)
    normals: Float[np.ndarray, "v 3"] | None = None  # None: from the quads


def make(
    positions: Float[np.ndarray, "v 3"],
    quads: Int[np.ndarray, "f 4"],
    weights: Float[np.ndarray, "v j"],
    material: str,
    *,
    uvs: Float[np.ndarray, "f 4 2"] | None = None,
    normals: Float[np.ndarray, "v 3"] | None = None,
    moves: dict[str, Float[np.ndarray, "v 3"]] | None = None,
    colours: Float[np.ndarray, "v 3"] | None = None,
) -> Surface:
    """A surface with defaults filled in."""
    tint = np.ones_like(positions) if colours is None else colours
    corners = np.zeros((len(quads), 4, 2)) if uvs is None else uvs
    return Surface(positions, quads, corners, weights, material, tint, moves or {}, normals)


def part(surface: Surface, keep: Bool[np.ndarray, " f"]) -> Surface:
    """Only these quads, and the vertices that they use."""
    used, local = np.unique(surface.quads[keep], return_inverse=True)
    return replace(
        surface,
        positions=surface.positions[used],
        quads=local.reshape(-1, 4),
        uvs=surface.uvs[keep],
        weights=surface.weights[used],
        colours=surface.colours[used],
        moves={name: move[used] for name, move in surface.moves.items()},
        normals=None if surface.normals is None else surface.normals[used],
    )


def between(rows: int, columns: int, *, is_closed: bool = False) -> Int[np.ndarray, "f 4"]:
    """Quads between neighbouring rows of points that are numbered row by row; closed rows end where they begin."""
    at = np.arange(rows * columns).reshape(rows, columns)
    at = np.concatenate([at, at[:, :1]], 1) if is_closed else at
    return np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], -1).reshape(-1, 4)


def triangles(quads: Int[np.ndarray, "f 4"]) -> Int[np.ndarray, "t 3"]:
    """Two triangles a quad; repeated corners give none."""
    both = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return np.asarray(both[(both[:, 0] != both[:, 1]) & (both[:, 1] != both[:, 2]) & (both[:, 2] != both[:, 0])])


def normals(positions: Float[np.ndarray, "v 3"], quads: Int[np.ndarray, "f 4"]) -> Float[np.ndarray, "v 3"]:
    """Unit normals of vertices: the mean of the faces around, by area."""
    faces = triangles(quads)
    a, b, c = (positions[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    total = np.zeros_like(positions)
    for i in range(3):
        np.add.at(total, faces[:, i], across)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))


def edges(quads: Int[np.ndarray, "f 4"]) -> Int[np.ndarray, "e 2"]:
    """Directed edges of all quads."""
    pairs = np.concatenate([np.stack([quads[:, i], quads[:, (i + 1) % 4]], 1) for i in range(4)])
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])


def border(quads: Int[np.ndarray, "f 4"]) -> Int[np.ndarray, "e 2"]:
    """Directed edges that belong to one quad."""
    pairs = edges(quads)
    count = int(pairs.max(initial=0)) + 1
    return np.asarray(pairs[~np.isin(pairs[:, 0] * count + pairs[:, 1], pairs[:, 1] * count + pairs[:, 0])])


def smoothed(
    values: Float[np.ndarray, "v d"],
    quads: Int[np.ndarray, "f 4"],
    passes: int,
    share: Float[np.ndarray, " v"] | float = 0.5,
) -> Float[np.ndarray, "v d"]:
    """Move values towards the mean of their neighbours; a border is smoothed along itself."""
    count = len(values)
    pairs, rim = edges(quads), border(quads)
    on_rim = np.zeros(count, bool)
    on_rim[rim] = True
    inner = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = np.concatenate([inner[~on_rim[inner[:, 0]]], rim, rim[:, ::-1]])
    around = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    around.data[:] = 1  # an edge of two quads counts once
    degree = np.asarray(around.sum(1))
    mixing = (np.broadcast_to(np.asarray(share, float), (count,)) * (degree > 0))[:, None]
    for _ in range(passes):
        values = values + mixing * (around @ values / np.maximum(degree, 1)[:, None] - values)
    return values


def subdivided(surface: Surface) -> Surface:
    """One step of Catmull-Clark; UVs are divided linearly."""
    quads, count = surface.quads, len(surface.positions)
    pairs = np.sort(np.stack([quads, np.roll(quads, -1, 1)], 2).reshape(-1, 2), 1)
    unique, index = np.unique(pairs, axis=0, return_inverse=True)
    edge_of = index.reshape(len(quads), 4)
    uses = np.bincount(index.ravel(), minlength=len(unique))

    def divide(values: Float[np.ndarray, "v d"], *, linear: bool = False) -> Float[np.ndarray, "w d"]:
        faces = values[quads].mean(1)
        middle = values[unique].mean(1)
        if linear:
            return np.concatenate([values, middle, faces])
        around = np.zeros_like(middle)
        np.add.at(around, edge_of.ravel(), np.repeat(faces, 4, axis=0))
        inner = uses == 2
        points = np.where(inner[:, None], (middle + around / np.maximum(uses, 1)[:, None]) / 2, middle)
        valence = np.zeros(count)
        total_edges, total_faces = np.zeros_like(values), np.zeros_like(values)
        for end in range(2):
            np.add.at(valence, unique[:, end], 1)
            np.add.at(total_edges, unique[:, end], middle)
        face_count = np.zeros(count)
        for corner in range(4):
            np.add.at(total_faces, quads[:, corner], faces)
            np.add.at(face_count, quads[:, corner], 1)
        n = np.maximum(valence, 1)[:, None]
        moved = (total_faces / np.maximum(face_count, 1)[:, None] + 2 * total_edges / n + (n - 3) * values) / n
        rim = np.zeros(count, bool)
        rim[unique[~inner]] = True
        along, ends = np.zeros_like(values), np.zeros(count)
        for end in range(2):
            np.add.at(along, unique[~inner, end], middle[~inner])
            np.add.at(ends, unique[~inner, end], 1)
        at_rim = np.where((ends == 2)[:, None], values / 2 + along / np.maximum(ends, 1)[:, None] / 2, values)
        return np.concatenate([np.where(rim[:, None], at_rim, moved), points, faces])

    made, corners = [], []
    for i in range(4):
        back = (i + 3) % 4
        made.append(
            np.stack(
                [
                    quads[:, i],
                    count + edge_of[:, i],
                    count + len(unique) + np.arange(len(quads)),
                    count + edge_of[:, back],
                ],
                1,
            )
        )
        uv = surface.uvs
        corners.append(
            np.stack([uv[:, i], (uv[:, i] + uv[:, (i + 1) % 4]) / 2, uv.mean(1), (uv[:, i] + uv[:, back]) / 2], 1)
        )
    return replace(
        surface,
        positions=divide(surface.positions),
        quads=np.concatenate(made),
        uvs=np.concatenate(corners),
        weights=divide(surface.weights, linear=True),
        colours=divide(surface.colours, linear=True),
        moves={name: divide(move) for name, move in surface.moves.items()},
        normals=None,
    )
