"""Clothes, grown from the base mesh's tights: cut along lines, loosened, folded, and hemmed with thickness."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, cKDTree

from . import fit
from .atlas import noise
from .base import load_base
from .body import Body
from .surface import Surface, border, make, normals, part, smoothed, subdivided

Points = Float[np.ndarray, "v 3"]
Field = Float[np.ndarray, " v"]
SHARPER = 2.6  # power that narrows the border between arm and trunk
CAP = (-0.055, 0.065)  # metres beyond the joint of a shoulder, where its round top passes from the trunk to the arm
TILE = 0.055  # metres of cloth in one picture of its weave
# Heights where top and trousers end: a thigh raised by 90 degrees reaches 1.04 in front of the belly.
HEM, ANKLE = 1.035, 0.072
GAP = 0.007  # metres between trousers and what is over or under them
RIB = 0.045  # metres of ribbing above the hem, which draws the top in


def tights(body: Body) -> Surface:
    """The helper that clothes grow from; UVs in tiles of cloth."""
    base = load_base()
    members = base.groups["helper-tights"]
    used, local = np.unique(base.quads[members], return_inverse=True)
    quads = local.reshape(-1, 4)
    uvs = base.uvs[base.uv_quads[members]]
    points = body.points[used]
    real = np.linalg.norm(points[quads[:, 1]] - points[quads[:, 0]], axis=1).sum()
    flat = np.linalg.norm(uvs[:, 1] - uvs[:, 0], axis=1).sum()
    uvs = uvs * (real / flat / TILE)
    return make(points, quads, body.weights[used], "cloth", uvs=uvs)


def neckline(points: Points, body: Body) -> Field:
    """Above 0 below a crew neck, in metres: a tilted ring round the neck, lower in front."""
    neck = body.joint("neck")
    front = np.clip((points[:, 2] - neck[2]) / 0.09, -1, 1)
    line = neck[1] + 0.013 - 0.034 * (front + 0.15)
    apart = np.hypot(points[:, 0], points[:, 2] - neck[2])
    side = np.clip(np.abs(points[:, 0]) / 0.085, 0, 1) ** 2
    on_head = points[:, 1] > neck[1] + 0.06
    wide = 0.074 + 0.03 * np.clip(front, 0, 1)
    far = 0.12 * np.clip((apart - wide) / 0.03, 0, 1) * ~on_head  # shoulders stay covered however high they are
    return line - 0.012 * side + far * np.clip((neck[2] + 0.085 - points[:, 2]) / 0.03, 0, 1) - points[:, 1]


def sleeves(points: Points, body: Body, weights: Float[np.ndarray, "v j"], back: float) -> Field:
    """Above 0 on the arm side of the cuffs, in metres; `back` is their distance from the wrist."""
    inside = np.full(len(points), 1.0)
    for side in ("left", "right"):
        elbow, wrist = body.joint(side + "LowerArm"), body.joint(side + "Hand")
        along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
        columns = [j for j, name in enumerate(fit.NAMES) if name.startswith(side) and ("Arm" in name or "Hand" in name)]
        near = weights[:, columns].sum(1) > 0.5
        inside = np.where(near, -((points - wrist) @ along) - back, inside)
    return inside


def top(body: Body, cloth: Surface) -> Surface:
    """A knitted jumper with a crew neck and ribbed hems."""
    cloth = subdivided(cloth)
    points = cloth.positions
    arm = _arm(cloth.weights)
    cut = np.minimum(neckline(points, body), sleeves(points, body, cloth.weights, 0.012))
    cut = np.minimum(cut, np.where(arm > 0.5, 1.0, points[:, 1] - _hem(points)))
    piece, at = _cut(cloth, cut)
    arm = _arm(piece.weights)
    places = smoothed(piece.positions, piece.quads, 14, 0.5)
    places = _draped(places, arm, body)
    out = normals(places, piece.quads)
    loose = np.where(arm > 0.5, 0.0075, 0.0125)
    edge = np.clip(at / 0.05, 0, 1)
    near_neck = np.clip(neckline(places, body) / 0.06, 0, 1)
    above = (places[:, 1] - HEM - RIB) / 0.04
    loose = loose * (0.45 + 0.55 * edge) * (0.55 + 0.45 * near_neck)
    blouse = np.exp(-((above - 0.7) ** 2)) * (arm < 0.5) * 0.005
    cuff = np.exp(-(((at - 0.055) / 0.025) ** 2)) * (arm > 0.5) * 0.004
    rim = np.zeros(len(places), bool)
    rim[border(piece.quads)] = True
    rim &= (arm < 0.5) & (places[:, 1] < HEM + 0.06)
    places[rim, 1] = _hem(places[rim])
    folds = 0.0022 * _folds(places, body, arm) + 0.0020 * noise(places, 0.07, 21) * edge
    places = places + out * (loose + blouse + cuff + folds * edge)[:, None]
    places = smoothed(places, piece.quads, 2, 0.4)
    rib = np.clip(1 - at / 0.045, 0, 1) > 0
    shade = np.where(rib, 0.90, 1.0) * (1 + 0.02 * noise(places, 0.05, 22))
    weights = _shoulders(smoothed(piece.weights, piece.quads, 3, 0.5), places, body)
    piece = replace(piece, positions=places, weights=weights, colours=np.repeat(shade[:, None], 3, 1))
    return _hemmed(piece, 0.0045, 0.02)


def _hem(points: Points) -> Field:
    """The height where the top ends: lower behind than in front, where thighs are raised."""
    return HEM + 0.015 * np.clip(points[:, 2] / 0.1, -1, 1)


def _shoulders(weights: Float[np.ndarray, "v j"], points: Points, body: Body) -> Float[np.ndarray, "v j"]:
    """Weights with a narrow border between arm and trunk, or a raised arm lifts the side and sinks at its top."""
    weights = weights.copy()
    for side in ("left", "right"):
        arm, chest = fit.NAMES.index(side + "UpperArm"), fit.NAMES.index("upperChest")
        share = weights[:, arm]
        sharp = share**SHARPER / (share**SHARPER + (1 - share) ** SHARPER)
        joint = body.joint(side + "UpperArm")
        along = body.joint(side + "LowerArm") - joint
        across = along / np.linalg.norm(along) + [np.sign(joint[0]), 0, 0]
        beyond = (points - joint) @ across / np.linalg.norm(across)
        passed = np.clip((beyond - CAP[0]) / (CAP[1] - CAP[0]), 0, 1)
        here = (points[:, 0] * joint[0] > 0) & (passed < 1)
        cap = np.where(here, passed * passed * (3 - 2 * passed), share)
        below = np.clip((joint[1] - points[:, 1] - 0.01) / 0.05, 0, 1)
        wanted = np.where(share > 0, cap + below * (sharp - cap), 0)
        rest = np.maximum(1 - share, 1e-6)
        others = np.where(share > 0.999, 0, (1 - wanted) / rest)
        weights = np.where((share > 0)[:, None], weights * others[:, None], weights)
        weights[:, arm] = wanted
        weights[:, chest] += 1 - weights.sum(1)
    return weights


def trousers(cloth: Surface, over: Surface, under: list[Surface]) -> Surface:
    """Straight trousers, which end a little above the hem of the top that is worn over them; shoes are under them."""
    points = cloth.positions
    arm = _arm(cloth.weights)
    cut = np.where(arm > 0.3, -1.0, np.minimum(HEM + 0.04 - points[:, 1], points[:, 1] - ANKLE))
    piece, _ = _cut(cloth, cut)
    places = smoothed(piece.positions, piece.quads, 5, 0.5)
    out = normals(places, piece.quads)
    low = np.clip((0.55 - places[:, 1]) / 0.45, 0, 1)
    covered = np.clip((places[:, 1] - HEM + 0.035) / 0.02, 0, 1)
    loose = 0.0055 * (1 - covered) + 0.004 * np.clip((0.85 - places[:, 1]) / 0.2, 0, 1) + 0.011 * low
    stack = (
        0.0035 * np.sin(places[:, 1] * 190 + 2.2 * noise(places, 0.06, 31)) * np.clip((0.22 - places[:, 1]) / 0.1, 0, 1)
    )
    knee = (
        np.exp(-(((places[:, 1] - 0.50) / 0.05) ** 2))
        * 0.0016
        * np.sin(places[:, 1] * 210 + 4 * noise(places, 0.08, 32))
    )
    folds = 0.0022 * noise(places * [1, 0.4, 1], 0.05, 33)
    places = places + out * (loose + stack + knee + folds)[:, None]
    places = smoothed(places, piece.quads, 2, 0.4)
    weights = smoothed(piece.weights, piece.quads, 3, 0.5)
    near, gap = _gap(places, out, over.positions)
    deep = GAP + 0.4 * np.maximum(places[:, 1] - _hem(places), 0)  # or coarse levels come through
    places = places - out * (covered * np.maximum(deep - gap, 0))[:, None]
    weights = weights + covered[:, None] * (over.weights[near] - weights)
    _, gap = _gap(places, out, np.concatenate([shoe.positions for shoe in under]))
    covers = np.clip((ANKLE + 0.05 - places[:, 1]) / 0.03, 0, 1)
    places = places + out * (covers * np.maximum(GAP + gap, 0))[:, None]
    shade = 1 + 0.03 * noise(places, 0.04, 34)
    piece = replace(
        piece, positions=places, weights=weights, material="trousers", colours=np.repeat(shade[:, None], 3, 1)
    )
    return _hemmed(piece, 0.003, 0.025)


def _gap(places: Points, out: Points, others: Points) -> tuple[Int[np.ndarray, " v"], Field]:
    """The nearest of others to each place, and how far out it is."""
    near = cKDTree(others).query(places)[1]
    return near, np.einsum("vi,vi->v", others[near] - places, out)


def shoes(body: Body, cloth: Surface) -> list[Surface]:
    """Plain trainers: an upper round each foot, and a light sole."""
    made = []
    cloth = subdivided(cloth)
    for side in ("left", "right"):
        columns = [fit.NAMES.index(side + part_name) for part_name in ("Foot", "Toes", "LowerLeg")]
        near = cloth.weights[:, columns].sum(1) > 0.5
        height = np.where(near, 0.088 - cloth.positions[:, 1], -1.0)
        piece, at = _cut(cloth, height)
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
        upper = replace(piece, positions=places, weights=foot, material="shoe")
        made.append(_hemmed(upper, 0.004, 0.02))
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
    quads = np.array(
        [
            [r * 44 + i, r * 44 + (i + 1) % 44, (r + 1) * 44 + (i + 1) % 44, (r + 1) * 44 + i]
            for r in range(len(rows) - 1)
            for i in range(44)
        ]
    )
    if np.mean(np.einsum("vi,vi->v", normals(points, quads)[:176], points[:176] - points.mean(0))) < 0:
        quads = quads[:, ::-1]
    weights = upper.weights[cKDTree(upper.positions).query(points)[1]]
    return make(points, quads, weights, "sole")


def _draped(places: Points, arm: Field, body: Body) -> Points:
    """Cloth of the trunk hangs: round each height it reaches as far out as what is within a hand's breadth above.

    Ribbing draws it in again by half.
    """
    middle = np.array([0.0, 0.0, -0.005])
    trunk = (arm < 0.35) & (places[:, 1] < body.joint("neck")[1] - 0.10)
    turn = np.arctan2(places[:, 0], places[:, 2] - middle[2])
    radius = np.hypot(places[:, 0], places[:, 2] - middle[2])
    heights, angles = np.linspace(HEM - 0.02, 1.34, 45), np.linspace(-np.pi, np.pi, 49)
    table = np.zeros((45, 49))
    known = cKDTree(np.stack([places[trunk, 1] / 0.02, np.cos(turn[trunk]) * 6, np.sin(turn[trunk]) * 6], 1))
    for row, height in enumerate(heights):
        probe = np.stack([np.full(49, height / 0.02), np.cos(angles) * 6, np.sin(angles) * 6], 1)
        table[row] = radius[trunk][known.query(probe, 5)[1]].mean(1)
    hung = table.copy()
    for row in range(len(heights) - 2, -1, -1):
        hung[row] = np.maximum(table[row], hung[row + 1] * 0.994)
    hung = gaussian_filter(hung, (2.5, 1.5), mode=("nearest", "wrap"))
    spread = RegularGridInterpolator(
        (heights, angles), np.maximum(hung / np.maximum(table, 1e-3), 1), bounds_error=False, fill_value=1.0
    )
    share = np.clip((0.35 - arm) / 0.25, 0, 1) * np.clip((1.30 - places[:, 1]) / 0.08, 0, 1)
    share = share * (0.5 + 0.5 * np.clip((places[:, 1] - HEM - 0.5 * RIB) / RIB, 0, 1))
    grow = 1 + (spread(np.stack([places[:, 1].clip(heights[0], heights[-1]), turn], 1)) - 1) * share * 0.85
    out = places.copy()
    out[:, [0, 2]] = (places[:, [0, 2]] - middle[[0, 2]]) * grow[:, None] + middle[[0, 2]]
    return out


def _arm(weights: Float[np.ndarray, "v j"]) -> Field:
    """How much a vertex belongs to an arm."""
    names = [j for j, name in enumerate(fit.NAMES) if "UpperArm" in name or "LowerArm" in name or "Hand" in name]
    return weights[:, names].sum(1)


def _folds(places: Points, body: Body, arm: Field) -> Field:
    """Rings of folds in the crook of the elbow and slanting ones from the armpit."""
    total = np.zeros(len(places))
    for side in ("left", "right"):
        elbow, wrist = body.joint(side + "LowerArm"), body.joint(side + "Hand")
        along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
        distance = (places - elbow) @ along
        near = np.exp(-(((places - elbow) ** 2).sum(1)) / 0.075**2) * (arm > 0.5)
        total += near * np.sin(distance * 170 + 2.5 * noise(places, 0.06, 23))
        shoulder = body.joint(side + "UpperArm") - [0, 0.06, 0]
        pit = np.exp(-(((places - shoulder) ** 2).sum(1)) / 0.09**2)
        slant = (places[:, 1] + np.abs(places[:, 0])) * 120
        total += 0.9 * pit * np.sin(slant + 2.5 * noise(places, 0.06, 24))
    return total


def _cut(surface: Surface, inside: Field) -> tuple[Surface, Field]:
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


def _hemmed(surface: Surface, thick: float, deep: float) -> Surface:
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
        uvs.append(uv_ring[local[:, [1, 0, 0, 1]]] + np.array([0, 0.02 * i]))
        before = now
    copies = len(rings)
    tint = np.concatenate(
        [surface.colours, *([surface.colours[vertices]] * (copies - 1)), surface.colours[vertices] * 0.35]
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
