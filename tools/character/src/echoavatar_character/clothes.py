"""Clothes, grown from the base mesh's tights: cut along lines, loosened, folded, and hemmed with thickness."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from . import fit
from .atlas import noise
from .base import load_base
from .body import Body
from .pieces import COLLAR_SPOT, charted, hemmed
from .pieces import cut as divided
from .surface import Surface, between, border, make, normals, smoothed, subdivided

Points = Float[np.ndarray, "v 3"]
Field = Float[np.ndarray, " v"]
SHARPER = 2.6  # power that narrows the border between arm and trunk
CAP = (-0.055, 0.065)  # metres beyond the joint of a shoulder, where its round top passes from the trunk to the arm
# Heights where top and trousers meet: a thigh raised by 90 degrees reaches 1.04 in front of the belly.
HEM, ANKLE = 1.035, 0.072
GAP = 0.007  # metres between trousers and what is over or under them
ARM_NAMES = [j for j, name in enumerate(fit.NAMES) if "UpperArm" in name or "LowerArm" in name or "Hand" in name]
AXIS = -0.005  # of the trunk: its z
TUCK = (0.070, 0.055)  # metres above the hem where a top comes out of the waistband, and over how many it does
MOST_TAKEN = 0.024  # metres that trousers are drawn in below a jacket, or hips stand out like a shelf
FLARE = 0.010  # metres that the hem of a jacket stands farther out than its chest
TAPER = 0.20  # metres above the hem over which cloth comes in to the waist
SLOPE = 0.020  # metres that cloth lies lower on the outer end of a shoulder than the mesh's square one
CHEST = (1.24, 1.33)  # metres: heights where a straight front begins to follow the chest, and where it does


class Cut(NamedTuple):
    """How an outfit is cut, in metres."""

    tucked: bool  # into the trousers
    loose: tuple[float, float]  # from the skin, on trunk and arms
    cuff: float  # from the wrist
    falls: float  # how far cloth hangs from the chest instead of following the trunk, 0 to 1
    blouse: float = 0.002  # how far cloth stands out above the hem
    collar: bool = False
    straight: bool = False  # from the chest to the waist: no hollow below the chest, no belly
    jacket: float = 0.0  # how far the open front of a jacket lies over what is worn below


CUTS = {
    "jumper": Cut(True, (0.0060, 0.0038), 0.012, 0.30, blouse=0.004),
    "shirt": Cut(True, (0.0090, 0.0060), 0.010, 0.45, blouse=0.0, collar=True, straight=True),
    "jacket": Cut(False, (0.0075, 0.0060), 0.014, 0.5, jacket=0.0045),
}


def tights(body: Body) -> Surface:
    """The helper that clothes grow from; UVs in its own chart, 0 to 1, v downwards."""
    base = load_base()
    members = base.groups["helper-tights"]
    used, local = np.unique(base.quads[members], return_inverse=True)
    uvs = base.uvs[base.uv_quads[members]]
    low, high = uvs.reshape(-1, 2).min(0), uvs.reshape(-1, 2).max(0)
    uvs = (uvs - low) / (high - low).max()
    uvs[..., 1] = 1 - uvs[..., 1]
    return make(body.points[used], local.reshape(-1, 4), body.weights[used], "cloth", uvs=uvs)


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
    """What is worn above the waist: follows the trunk, falls a little from the chest, and has cuffs and a neckline."""
    own = CUTS[body.person.cut]
    cloth = subdivided(cloth)
    points = cloth.positions
    arm = _arm(cloth.weights)
    cut = np.minimum(neckline(points, body), sleeves(points, body, cloth.weights, own.cuff))
    low = HEM + 0.004 if own.tucked else _hem(points)
    cut = np.minimum(cut, np.where(arm > 0.5, 1.0, points[:, 1] - low))
    piece, at = divided(cloth, cut)
    arm = _arm(piece.weights)
    places = _spanned(
        smoothed(piece.positions, piece.quads, 8, 0.5), piece.quads, np.clip(1 - 3 * arm, 0, 1) * own.falls
    )
    places = _straight(places, piece.quads, arm, body) if own.straight else _draped(places, arm, body, own.falls)
    places = _sloped(places, body)
    out = normals(places, piece.quads)
    loose = np.where(arm > 0.5, own.loose[1], own.loose[0])
    edge = np.clip(at / 0.05, 0, 1)
    near_neck = np.clip(neckline(places, body) / 0.06, 0, 1)
    above = (places[:, 1] - HEM - 0.062) / 0.022
    loose = loose * (0.35 + 0.65 * edge) * (0.4 + 0.6 * near_neck)
    if own.straight:  # or a belly hangs over the belt
        loose = loose * np.where(arm > 0.5, 1, 0.3 + 0.7 * np.clip((places[:, 1] - HEM - 0.06) / 0.14, 0, 1))
    blouse = np.exp(-(above**2)) * (arm < 0.5) * own.blouse
    if own.jacket:  # it stands off the waist, or hips stand out like a shelf
        blouse += FLARE * np.clip((HEM + 0.12 - places[:, 1]) / 0.12, 0, 1) * (arm < 0.5)
    rim = np.zeros(len(places), bool)
    rim[border(piece.quads)] = True
    rim &= (arm < 0.5) & (places[:, 1] < HEM + 0.06) & (not own.tucked)
    places[rim, 1] = _hem(places[rim])
    folds = 0.0016 * _folds(places, body, arm) + 0.0012 * noise(places, 0.07, 21) * edge
    over = own.jacket * np.clip((opening(places, body) + 0.002) / 0.006, 0, 1)
    places = places + out * (loose + blouse + over + folds * edge)[:, None]
    places = smoothed(places, piece.quads, 2, 0.4)
    weights = _shoulders(_calmed(smoothed(piece.weights, piece.quads, 3, 0.5), piece.quads), places, body)
    shade = 1 + 0.02 * noise(places, 0.05, 22)
    piece = replace(piece, positions=places, weights=weights, colours=np.repeat(shade[:, None], 3, 1))
    return charted(hemmed(piece, 0.003, 0.011), "cloth")


def _spanned(places: Points, quads: Int[np.ndarray, "f 4"], share: Field) -> Points:
    """Cloth that spans hollows, such as that below a chest, as far as `share` says; what stands out stays."""
    out = normals(places, quads)
    filled = ((smoothed(places, quads, 90, 0.5) - places) * out).sum(1)
    return places + out * (share * smoothed(np.maximum(filled, 0)[:, None], quads, 6, 0.5)[:, 0])[:, None]


def opening(points: Points, body: Body) -> Field:
    """How far a point lies beside the open front of a jacket, in metres: above 0 on its cloth."""
    neck = body.joint("neck")
    wide = np.interp(points[:, 1], [HEM, HEM + 0.12, neck[1] - 0.10, neck[1] + 0.01], [0.050, 0.047, 0.062, 0.080])
    front = points[:, 2] > neck[2] + 0.035 * np.clip((points[:, 1] - neck[1] + 0.06) / 0.05, 0, 1)
    return np.where(front, np.abs(points[:, 0]) - wide, 0.1)


def collar(body: Body, top: Surface) -> Surface:
    """A shirt's collar: a band that stands round the neck and falls over itself, open in front."""
    middle = body.joint("neck") * [0, 1, 1]
    rim = np.unique(border(top.quads))
    near = np.hypot(*(top.positions[rim] - middle)[:, [0, 2]].T) < 0.12
    rim = rim[near & (top.positions[rim, 1] > body.joint("neck")[1] - 0.12)]
    rel = top.positions[rim] - middle
    order = np.argsort(np.arctan2(rel[:, 0], rel[:, 2]))
    turn, rel = np.arctan2(rel[order, 0], rel[order, 2]), rel[order]
    at = np.linspace(np.radians(7), 2 * np.pi - np.radians(7), 85)
    wrapped = [np.concatenate([values] * 3) for values in (np.hypot(rel[:, 0], rel[:, 2]), rel[:, 1])]
    turns = np.concatenate([turn - 2 * np.pi, turn, turn + 2 * np.pi])
    far, low = (gaussian_filter(np.interp(at, turns, values), 4.0, mode="nearest") for values in wrapped)
    front = np.clip((np.cos(at) - 0.55) / 0.45, 0, 1)
    aside = np.degrees(np.minimum(at, 2 * np.pi - at))
    stand = 0.026 - 0.006 * front
    fall = np.interp(aside, [7, 23, 80, 110], [0.032, 0.094, 0.048, 0.042])  # straight to its points and from them
    rows: list[tuple[Field | float, Field | float]]
    rows = [(-0.004, -0.006), (-0.001, 0.3 * stand), (-0.006, 0.7 * stand), (-0.010, stand), (-0.0065, stand + 0.003)]
    rows += [
        (-0.001, stand),
        (0.006, stand - 0.35 * fall),
        (0.0125, stand - 0.7 * fall),
        (0.018 - 0.003 * front, stand - fall),
    ]
    points = []
    for out, up in rows:
        points.append(np.stack([(far + out) * np.sin(at), low + up, (far + out) * np.cos(at)], 1) + middle)
    count, grid = len(at), np.concatenate(points)
    quads = between(len(rows), count)
    fallen = np.repeat([0.0] * 5 + [0.3, 0.8, 1, 1], count)[:, None]
    for _ in range(4):
        near = cKDTree(top.positions).query(grid)[1]
        out = normals(top.positions, top.quads)[near]
        gap = ((grid - top.positions[near]) * out).sum(1, keepdims=True)
        grid = grid + fallen * out * np.maximum(0.012 - gap, 0)
    grid = smoothed(grid, quads, 1, 0.4 * (np.arange(len(grid)) < len(grid) - count))  # points stay sharp
    weights = top.weights[cKDTree(top.positions).query(grid)[1]]
    weights = smoothed(weights, quads, 12, 0.5)
    share = (np.arange(len(grid)) % count / (count - 1), np.arange(len(grid)) // count / (len(rows) - 1))
    a, b, c, d = COLLAR_SPOT
    uvs = np.stack([a + (c - a) * share[0], b + (d - b) * share[1]], 1)[quads]
    return make(grid, quads, weights, "cloth", uvs=uvs)


def _hem(points: Points) -> Field:
    """The height where the top ends: lower behind than in front, where thighs are raised."""
    return HEM + 0.015 * np.clip(points[:, 2] / 0.1, -1, 1)


def _calmed(weights: Float[np.ndarray, "v j"], quads: Int[np.ndarray, "f 4"]) -> Float[np.ndarray, "v j"]:
    """Weights whose collar bones fade over the chest, or straight seams bend where they end."""
    bones = [fit.NAMES.index(f"{side}Shoulder") for side in ("left", "right")]
    weights, before = weights.copy(), weights[:, bones]
    weights[:, bones] = smoothed(before, quads, 30, 0.5 * np.clip(1 - 3 * _arm(weights), 0, 1))
    weights[:, fit.NAMES.index("upperChest")] += (before - weights[:, bones]).sum(1)
    weights = np.maximum(weights, 0)
    return np.asarray(weights / weights.sum(1, keepdims=True))


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


def trousers(cloth: Surface, under: list[Surface]) -> Surface:
    """Straight trousers with a waistband above the hips; shoes are under them."""
    points = cloth.positions
    arm = _arm(cloth.weights)
    cut = np.where(arm > 0.3, -1.0, np.minimum(HEM + 0.018 - points[:, 1], points[:, 1] - ANKLE))
    piece, _ = divided(cloth, cut)
    places = smoothed(piece.positions, piece.quads, 5, 0.5)
    out = normals(places, piece.quads)
    low = np.clip((0.55 - places[:, 1]) / 0.45, 0, 1)
    waist = np.clip((places[:, 1] - HEM + 0.05) / 0.03, 0, 1)
    loose = 0.0050 + 0.003 * waist + 0.003 * np.clip((0.85 - places[:, 1]) / 0.2, 0, 1) + 0.010 * low
    stack = 0.0030 * np.sin(places[:, 1] * 190 + 2.2 * noise(places, 0.06, 31))
    stack = stack * np.clip((0.22 - places[:, 1]) / 0.1, 0, 1)
    knee = np.exp(-(((places[:, 1] - 0.50) / 0.05) ** 2)) * np.sin(places[:, 1] * 210 + 4 * noise(places, 0.08, 32))
    crotch = np.exp(-(((places - [0, 0.83, 0.08]) / [0.09, 0.05, 0.07]) ** 2).sum(1))
    crease = np.sin((places[:, 1] + 0.7 * np.abs(places[:, 0])) * 190)
    folds = 0.0016 * knee + 0.0010 * crotch * crease + 0.0018 * noise(places * [1, 0.4, 1], 0.05, 33) * (1 - waist)
    places = places + out * (loose + stack + folds)[:, None]
    places = smoothed(places, piece.quads, 2, 0.4)
    weights = _firm(smoothed(piece.weights, piece.quads, 3, 0.5), places)
    _, gap = _gap(places, out, np.concatenate([shoe.positions for shoe in under]))
    covers = np.clip((ANKLE + 0.05 - places[:, 1]) / 0.03, 0, 1)
    places = places + out * (covers * np.maximum(GAP + gap, 0))[:, None]
    shade = 1 + 0.03 * noise(places, 0.04, 34)
    piece = replace(piece, positions=places, weights=weights, colours=np.repeat(shade[:, None], 3, 1))
    return charted(hemmed(piece, 0.003, 0.009), "trousers")


def _firm(weights: Float[np.ndarray, "v j"], points: Points) -> Float[np.ndarray, "v j"]:
    """Weights of a waistband that no thigh moves: what legs have of it goes to the hips."""
    legs = [fit.NAMES.index(f"{side}UpperLeg") for side in ("left", "right")]
    taken = weights[:, legs] * np.clip((points[:, 1:2] - HEM + 0.065) / 0.04, 0, 1)
    weights = weights.copy()
    weights[:, legs] -= taken
    weights[:, fit.NAMES.index("hips")] += taken.sum(1)
    return weights


def tucked(inner: Surface, over: Surface, *, upwards: bool) -> Surface:
    """The inner piece with what is at the waist moved below the outer one, and skinned as it.

    `upwards`: the inner piece's top is below the outer one, as trousers under a jacket; else its bottom.
    """
    places, high = inner.positions, inner.positions[:, 1] - HEM
    covered = np.clip((high + 0.09) / 0.06, 0, 1) if upwards else np.clip((TUCK[0] - high) / TUCK[1], 0, 1)
    covered = covered * (_arm(inner.weights) < 0.3)
    radius, turn = _round(places)
    theirs, turns = _round(over.positions)
    outwards = (normals(over.positions, over.quads) * np.stack([np.sin(turns), 0 * turns, np.cos(turns)], 1)).sum(
        1
    ) > 0.05
    near = np.flatnonzero(outwards & (np.abs(over.positions[:, 1] - HEM) < 0.12) & (_arm(over.weights) < 0.3))
    known = np.stack([over.positions[near, 1], turns[near] * 0.15], 1)  # a radian is about 0.15 m
    laps = np.concatenate([known + [0, lap * 0.3 * np.pi] for lap in (-1, 0, 1)])
    apart, which = cKDTree(laps).query(np.stack([places[:, 1], turn * 0.15], 1), 4)
    share = 1 / (apart + 1e-4) ** 2
    share = (share / share.sum(1, keepdims=True))[..., None]
    which = near[which % len(near)]
    found, weights = (share * theirs[which][..., None]).sum(1)[:, 0], (share * over.weights[which]).sum(1)
    deep = (2.1 if upwards else 2.0) * GAP + 0.4 * np.maximum(
        high if upwards else 0.012 - high, 0
    )  # or coarse levels come through
    taken = np.clip(radius - found + deep, 0, MOST_TAKEN if upwards else None)
    shrunk = 1 - covered * taken / np.maximum(radius, 1e-3)
    places = np.stack([places[:, 0] * shrunk, places[:, 1], (places[:, 2] - AXIS) * shrunk + AXIS], 1)
    weights = inner.weights + covered[:, None] * (weights - inner.weights)
    return replace(inner, positions=places, weights=weights)


def _round(points: Points) -> tuple[Field, Field]:
    """How far points are from the trunk's axis, and in which direction, in radians."""
    return np.hypot(points[:, 0], points[:, 2] - AXIS), np.arctan2(points[:, 0], points[:, 2] - AXIS)


def _gap(places: Points, out: Points, others: Points) -> tuple[Int[np.ndarray, " v"], Field]:
    """The nearest of others to each place, and how far out it is."""
    near = cKDTree(others).query(places)[1]
    return near, np.einsum("vi,vi->v", others[near] - places, out)


def _draped(places: Points, arm: Field, body: Body, strength: float) -> Points:
    """Cloth of the trunk hangs: by `strength` it reaches as far out as what is above it; the waist draws it in."""
    heights, angles, table = _radii(places, arm, body)
    hung = table.copy()
    for row in range(len(heights) - 2, -1, -1):
        hung[row] = np.maximum(table[row], hung[row + 1] * (0.98 + 0.018 * strength))
    hung = gaussian_filter(hung, (4.5, 2.5), mode=("nearest", "wrap"))
    share = np.clip((0.35 - arm) / 0.25, 0, 1) * np.clip((1.30 - places[:, 1]) / 0.08, 0, 1)
    if not CUTS[body.person.cut].jacket:
        share = share * np.clip((places[:, 1] - HEM) / TAPER, 0, 1)
    grow = 1 + (_at(hung / np.maximum(table, 1e-3), heights, angles, places) - 1) * share * strength
    return _widened(places, grow)


def _straight(places: Points, quads: Int[np.ndarray, "f 4"], arm: Field, body: Body) -> Points:
    """Cloth of the trunk runs straight from the chest to the waist, all round, whatever the body below it does."""
    heights, angles, table = _radii(places, arm, body)
    low = table[(heights > HEM) & (heights < HEM + 0.03)].mean(0)
    high = table[(heights > CHEST[0] + 0.01) & (heights < CHEST[1] - 0.03)].mean(0)
    low, high = (gaussian_filter(each, 2.0, mode="wrap") for each in (low, high))
    up = ((heights - HEM) / (CHEST[1] - HEM - 0.03)).clip(0, 1)[:, None]
    hung = low + (high - low) * up
    radius, _ = _round(places)
    share = np.clip((0.60 - arm) / 0.25, 0, 1) * np.clip((CHEST[1] - places[:, 1]) / (CHEST[1] - CHEST[0]), 0, 1)
    share = share * (places[:, 1] < CHEST[1])
    grow = 1 + (_at(hung, heights, angles, places) / np.maximum(radius, 1e-3) - 1) * share
    places = _widened(places, grow)
    return smoothed(places, quads, 12, 0.5 * np.clip((0.6 - arm) / 0.2, 0, 1) * (places[:, 1] < CHEST[1] + 0.06))


def _sloped(places: Points, body: Body) -> Points:
    """Shoulders that fall from the neck to their outer end, where those of the mesh are level."""
    out = places.copy()
    for side in ("left", "right"):
        joint = body.joint(side + "UpperArm")
        beside = np.clip((places[:, 0] * np.sign(joint[0]) - 0.09) / (abs(joint[0]) - 0.07), 0, 1)
        above = np.clip((places[:, 1] - joint[1] + 0.07) / 0.07, 0, 1)
        out[:, 1] -= SLOPE * beside * beside * (3 - 2 * beside) * above
    return out


def _radii(places: Points, arm: Field, body: Body) -> tuple[Field, Field, Float[np.ndarray, "h a"]]:
    """How far cloth of the trunk is from the trunk's axis, in metres, with the heights and the angles of the table."""
    trunk = (arm < 0.35) & (places[:, 1] < body.joint("neck")[1] - 0.10)
    radius, turn = (each[trunk] for each in _round(places))
    heights, angles = np.linspace(HEM - 0.02, 1.34, 45), np.linspace(-np.pi, np.pi, 49)
    table = np.zeros((45, 49))
    known = cKDTree(np.stack([places[trunk, 1] / 0.02, np.cos(turn) * 6, np.sin(turn) * 6], 1))
    for row, height in enumerate(heights):
        probe = np.stack([np.full(49, height / 0.02), np.cos(angles) * 6, np.sin(angles) * 6], 1)
        table[row] = radius[known.query(probe, 5)[1]].mean(1)
    return heights, angles, table


def _at(table: Float[np.ndarray, "h a"], heights: Field, angles: Field, places: Points) -> Field:
    """The values of a table at each place round the trunk."""
    spread = RegularGridInterpolator((heights, angles), table, bounds_error=False, fill_value=None)
    return np.asarray(spread(np.stack([places[:, 1].clip(heights[0], heights[-1]), _round(places)[1]], 1)))


def _widened(places: Points, grow: Field) -> Points:
    """Places whose distance from the trunk's axis is multiplied."""
    axis = np.array([0.0, 0.0, AXIS])
    return (places - axis) * np.stack([grow, np.ones_like(grow), grow], 1) + axis


def _arm(weights: Float[np.ndarray, "v j"]) -> Field:
    """How much a vertex belongs to an arm."""
    return weights[:, ARM_NAMES].sum(1)


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
