"""Teeth and tongue. They follow the jaw as the base mesh's helpers do, as rigid parts: their shape is frozen."""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.arkit import ARKIT_NAMES

from . import atlas
from .base import load_base
from .body import Body
from .surface import Surface, between, make

WIDTHS = (8.6, 6.6, 7.6, 7.0, 6.8, 9.5, 9.0)  # millimetres of the teeth of one side, from the middle
PER_TOOTH = 4
BACK, SIDES = np.array([0.42, 0.20, 0.19]), np.array([0.34, 0.46, 0.48])  # light in a mouth is dim and red
WHITE, GUM = np.array([0.93, 0.88, 0.79]), np.array([0.42, 0.15, 0.15])


def teeth(body: Body, *, upper: bool) -> Surface:
    """One row of teeth with its gum, along the arch of the helper."""
    group = "helper-upper-teeth" if upper else "helper-lower-teeth"
    members = load_base().vertices_of(group)
    helper = body.points[members]
    arch = _arch(helper)
    low, high = helper[:, 1].min(), helper[:, 1].max()
    gum, edge = (high, low - 0.0030) if upper else (low + 0.006, high - 0.0054)
    widths = np.array(WIDTHS[::-1] + WIDTHS)
    borders = np.concatenate([[0], widths.cumsum()]) / widths.sum()
    local = np.linspace(0, 1, PER_TOOTH, endpoint=False)
    share = np.concatenate([[a + (b - a) * t for t in local] for a, b in zip(borders[:-1], borders[1:], strict=True)])
    phase = np.tile(local, len(widths)) * 2 - 1
    place, out = _on_arch(arch, share)
    from_middle = np.abs(share - 0.5) * 2
    rows, tints = [], []
    profile = [
        (-0.25, 0.0, 0),
        (0.12, 0.0012, 0),
        (0.26, 0.0008, 0.6),
        (0.45, 0.0014, 1),
        (0.75, 0.0012, 1),
        (0.95, 0.0004, 1),
        (1.0, -0.0010, 1),
        (0.75, -0.0042, 1),
        (0.1, -0.0062, 0.3),
        (-0.25, -0.0070, 0),
    ]
    for v, depth, white in profile:
        rounding = np.abs(phase) ** 3
        canine = 0.0004 * np.exp(-(((from_middle - 0.36) / 0.06) ** 2))
        reach = v - 0.022 * rounding * (v > 0.5) + (canine - 0.0006 * from_middle**2) / 0.010 * (v > 0.5)
        scallop = 0.10 * (1 - phase**2) * (0.2 < v < 0.4)
        y = gum + (edge - gum) * (reach - scallop)
        gap = 0.0006 * np.abs(phase) ** 6 * (v > 0.2) * (depth > -0.002)
        shift = depth - gap - 0.0010 - 0.0012 * from_middle
        rows.append(np.stack([place[:, 0] + out[:, 0] * shift, y, place[:, 1] + out[:, 1] * shift], 1))
        dark = 1 - 0.32 * (np.abs(phase) ** 6 * (v > 0.2))
        tone = (GUM + (WHITE - GUM) * white) * dark[:, None]
        shade = 1 if upper else 0.86  # the lip is above the lower row
        inside = BACK if depth < -0.002 else 1 - from_middle[:, None] ** 1.6 * SIDES
        tints.append(tone * inside * shade)
    points, count = np.concatenate(rows), len(share)
    quads = between(len(rows), count)[:, [0, 3, 2, 1]]
    if upper:  # rows run from the gum to the edge: downwards above, upwards below
        quads = quads[:, ::-1]
    spots = np.tile(atlas.within(atlas.TEETH, np.array([[0.5, 0.5]])), (len(quads), 4, 1))
    moves = {}
    if not upper:
        frame = np.concatenate([helper, np.ones((len(helper), 1))], 1)
        for name in ARKIT_NAMES:
            move = body.move(name)[members]
            if np.abs(move).max() > 1e-4:
                rigid = np.linalg.lstsq(frame, move, rcond=None)[0]
                moves[name] = np.concatenate([points, np.ones((len(points), 1))], 1) @ rigid
    return make(
        points, quads, body.one("head", len(points)), "mouth", uvs=spots, moves=moves, colours=np.concatenate(tints)
    )


def tongue(body: Body) -> Surface:
    """The helper's tongue."""
    base = load_base()
    used, local = np.unique(base.quads[base.groups["helper-tongue"]], return_inverse=True)
    quads = local.reshape(-1, 4)
    spots = np.tile(atlas.within(atlas.TONGUE, np.array([[0.5, 0.5]])), (len(quads), 4, 1))
    moves = {name: body.move(name)[used] for name in ARKIT_NAMES}
    depth = np.clip((body.points[used, 2] - 0.03) / 0.07, 0.25, 1)[:, None]
    moves = {name: move for name, move in moves.items() if np.abs(move).max() > 1e-5}
    tint = np.array([0.56, 0.22, 0.22]) * depth
    return make(body.points[used], quads, body.one("head", len(used)), "mouth", uvs=spots, moves=moves, colours=tint)


def _arch(helper: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 2"]:
    """The outer line of the helper seen from above, x and z, from right to left and symmetric."""
    from scipy.spatial import ConvexHull

    flat = helper[:, [0, 2]]
    hull = flat[ConvexHull(flat).vertices]
    hull = hull[hull[:, 1] > flat[:, 1].min() + 1e-4]
    hull = hull[np.argsort(hull[:, 0])]
    return hull


def _on_arch(
    arch: Float[np.ndarray, "m 2"], share: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Places and outward normals along the arch by length."""
    from scipy.interpolate import UnivariateSpline

    length = np.concatenate([[0], np.linalg.norm(np.diff(arch, axis=0), axis=1).cumsum()])
    at = length / length[-1]
    curves = [UnivariateSpline(at, arch[:, i], s=len(at) * (0.0004**2)) for i in range(2)]
    place = np.stack([curve(share) for curve in curves], 1)
    along = np.stack([curve.derivative()(share) for curve in curves], 1)
    out = np.stack([-along[:, 1], along[:, 0]], 1)
    return place, out / np.linalg.norm(out, axis=1, keepdims=True)
