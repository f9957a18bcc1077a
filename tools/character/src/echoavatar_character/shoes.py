"""Shoes: an upper round each foot, and a light sole."""

from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from . import fit
from .body import Body
from .pieces import charted, cut, hemmed
from .surface import Surface, between, make, normals, smoothed, subdivided


def shoes(body: Body, cloth: Surface) -> list[Surface]:
    """Plain trainers: an upper round each foot, and a light sole."""
    made = []
    cloth = subdivided(cloth)
    for side in ("left", "right"):
        columns = [fit.NAMES.index(side + part_name) for part_name in ("Foot", "Toes", "LowerLeg")]
        near = cloth.weights[:, columns].sum(1) > 0.5
        height = np.where(near, 0.088 - cloth.positions[:, 1], -1.0)
        piece, at = cut(cloth, height)
        places = smoothed(piece.positions, piece.quads, 9, 0.5)
        out = normals(places, piece.quads)
        places = places + out * 0.0085
        foot = smoothed(piece.weights, piece.quads, 4, 0.5)
        front = np.clip((places[:, 2] - places[:, 2].max() + 0.05) / 0.05, 0, 1)
        ankle = fit.NAMES.index(side + "Foot")
        ground = body.joint(side + "Foot")[1] - fit.REST[ankle, 1]  # legs stand apart in the modelled pose
        floor = ground + 0.012 + 0.010 * front**2
        places[:, 1] = np.where(
            places[:, 1] < floor + 0.004, floor + 0.25 * (places[:, 1] - floor).clip(0), places[:, 1]
        )
        upper = charted(replace(piece, positions=places, weights=foot), "shoe")
        made.append(hemmed(upper, 0.004, 0.02))
        made.append(_sole(upper, ground))
    return made


def _sole(upper: Surface, ground: float) -> Surface:
    """The sole: the outline of the shoe seen from above, as a band with a bevel and a bottom."""
    flat = upper.positions[upper.positions[:, 1] < ground + 0.05][:, [0, 2]]
    hull = flat[ConvexHull(flat).vertices]
    closed = np.concatenate([hull, hull[:1]])
    length = np.concatenate([[0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    at = np.linspace(0, length[-1], 44, endpoint=False)
    ring = np.stack([np.interp(at, length, closed[:, i]) for i in range(2)], 1)
    for _ in range(3):
        ring = (np.roll(ring, 1, 0) + 2 * ring + np.roll(ring, -1, 0)) / 4
    middle = ring.mean(0)
    rise = 0.009 * np.clip((ring[:, 1] - ring[:, 1].max() + 0.06) / 0.06, 0, 1) ** 2
    rows = []
    for height, out in (
        (0.030, -0.0035),
        (0.0305, 0.0040),
        (0.028, 0.0060),
        (0.008, 0.0060),
        (0.002, 0.0030),
        (0.0, -0.005),
    ):
        direction = (ring - middle) / np.linalg.norm(ring - middle, axis=1, keepdims=True)
        moved = ring + direction * out
        rows.append(np.stack([moved[:, 0], ground + height + rise * (0.6 if height < 0.01 else 1), moved[:, 1]], 1))
    rows.append(np.tile([middle[0], ground, middle[1]], (44, 1)))
    points = np.concatenate(rows)
    quads = between(len(rows), 44, is_closed=True)[:, [0, 3, 2, 1]]
    if np.mean(np.einsum("vi,vi->v", normals(points, quads)[:176], points[:176] - points.mean(0))) < 0:
        quads = quads[:, ::-1]
    weights = upper.weights[cKDTree(upper.positions).query(points)[1]]
    return make(points, quads, weights, "sole")
