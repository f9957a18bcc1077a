"""What all garments share: the cut along a line, hems with thickness, and places in the picture of the clothes."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .surface import Surface, border, normals, part

Field = Float[np.ndarray, " v"]
# Places in the picture of the clothes: the base mesh's tights (from, to in its chart), and plain spots.
CHARTS = {
    "cloth": ((0.0, 0.0, 0.664, 0.46), (0.005, 0.005, 0.995, 0.62)),
    "trousers": ((0.05, 0.27, 0.61, 0.76), (0.005, 0.63, 0.695, 0.995)),
    "shoe": ((0.055, 0.79, 0.62, 1.0), (0.705, 0.63, 0.995, 0.80)),
}
COLLAR_SPOT = (0.75, 0.85, 0.85, 0.95)


def charted(surface: Surface, material: str) -> Surface:
    """The surface with its material, and its place in the picture of the clothes."""
    (left, top, right, bottom), (a, b, c, d) = CHARTS[material]
    share = (surface.uvs - [left, top]) / [right - left, bottom - top]
    beyond = (np.abs(share.mean(1) - 0.5) > 0.5).any(1)  # of a leg where a foot's chart begins, or the reverse
    share[beyond] = {"cloth": (0.5, 0.5), "trousers": (0.18, 0.92), "shoe": (0.25, 0.12)}[material]
    return replace(surface, material=material, uvs=np.array([a, b]) + share.clip(0, 1) * [c - a, d - b])


def cut(surface: Surface, inside: Field) -> tuple[Surface, Field]:
    """The part where `inside` is positive; vertices near its border move onto it, so that it is smooth."""
    points, at = surface.positions.copy(), inside.astype(float).copy()
    pairs = np.unique(np.sort(np.stack([surface.quads, np.roll(surface.quads, -1, 1)], 2).reshape(-1, 2), 1), axis=0)
    a, b = pairs[(at[pairs[:, 0]] > 0) != (at[pairs[:, 1]] > 0)].T
    share = at[a] / (at[a] - at[b])
    crossing = points[a] + (points[b] - points[a]) * share[:, None]
    mover = np.where(share < 0.5, a, b)
    total, count = np.zeros_like(points), np.zeros(len(points))
    np.add.at(total, mover, crossing)
    np.add.at(count, mover, 1)
    moved = count > 0
    points[moved] = total[moved] / count[moved, None]
    at[moved] = 0
    good = at >= 0
    quads = surface.quads.copy()
    uvs = surface.uvs.copy()
    kept = good[quads].sum(1)
    for row in np.flatnonzero(kept == 3):
        out = int(np.flatnonzero(~good[quads[row]])[0])
        order = [(out + 1) % 4, (out + 2) % 4, (out + 3) % 4, (out + 3) % 4]
        quads[row], uvs[row] = quads[row][order], uvs[row][order]
    keep = (kept >= 3) & (at[quads].max(1) > 0)
    whole = replace(surface, positions=points, quads=quads, uvs=uvs, colours=np.stack([at, at, at], 1))
    piece = part(whole, keep)
    return replace(piece, colours=np.ones_like(piece.positions)), piece.colours[:, 0]


def hemmed(surface: Surface, thick: float, deep: float) -> Surface:
    """Turn every border inwards over a rounded edge, so that cloth has thickness."""
    rim = border(surface.quads)
    out = normals(surface.positions, surface.quads)
    vertices = np.unique(rim)
    place = {int(v): i for i, v in enumerate(vertices)}
    away = np.zeros((len(vertices), 3))
    for a, b in rim.tolist():
        edge = surface.positions[b] - surface.positions[a]
        for v in (a, b):
            away[place[v]] += np.cross(edge, out[v])
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    rings = [
        (0.45 * thick, -0.15 * thick),
        (0.55 * thick, -0.5 * thick),
        (0.2 * thick, -0.95 * thick),
        (-deep, -1.05 * thick),
    ]
    points, quads, uvs = [surface.positions], [surface.quads], [surface.uvs]
    before = vertices
    local = np.array([[place[a], place[b]] for a, b in rim.tolist()])
    uv_at = np.zeros((len(surface.positions), 2))
    uv_at[surface.quads.ravel()] = surface.uvs.reshape(-1, 2)
    uv_ring = uv_at[vertices]
    for i, (along, up) in enumerate(rings):
        points.append(surface.positions[vertices] + away * along + out[vertices] * up)
        now = len(surface.positions) + i * len(vertices) + np.arange(len(vertices))
        quads.append(np.stack([before[local[:, 1]], before[local[:, 0]], now[local[:, 0]], now[local[:, 1]]], 1))
        uvs.append(uv_ring[local[:, [1, 0, 0, 1]]])
        before = now
    copies = len(rings)
    tint = np.concatenate(
        [surface.colours, *([surface.colours[vertices]] * (copies - 1)), surface.colours[vertices] * 0.55]
    )
    weights = np.concatenate([surface.weights, *([surface.weights[vertices]] * copies)])
    return replace(
        surface,
        positions=np.concatenate(points),
        quads=np.concatenate(quads),
        uvs=np.concatenate(uvs),
        weights=weights,
        colours=tint,
    )
