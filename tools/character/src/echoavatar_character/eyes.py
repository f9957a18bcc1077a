"""Eyeballs with a cornea and an iris, the turns of the eyes, and lashes."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from echoavatar.motion.arkit import ARKIT_NAMES

from . import atlas
from .base import load_base
from .body import Body, Eye
from .person import Person
from .surface import Surface, between, border, make

AROUND, RINGS = 24, 14
FAR = np.radians(112)  # how far back the eyeball reaches
IRIS = np.radians(29.5)  # half the angle of the iris
ACROSS, UPWARDS = 0.52, 0.42  # radians of a full look
TOE_IN = 0.022  # radians: at rest both eyes look at someone 1.4 m away
LINE, STRANDS = 16, 30  # pieces of the dark line at the lid, and lashes
LIFT = 0.0019  # metres that lashes stand off the lid, or they sink into it
BASE = 0.026  # half the width of a lash at its root, as a share of the lid


def eyeball(body: Body, side: str) -> Surface:
    """One eyeball; curves of both eyes turn it as far as they concern its side."""
    eye = body.eyes[side]
    angles = FAR * np.linspace(0, 1, RINGS) ** 1.25
    turn = np.arange(AROUND) * 2 * np.pi / AROUND
    bulge = 0.055 * np.clip(1 - (angles / (IRIS * 1.25)) ** 2, 0, 1)
    radius = eye.radius * (0.985 + bulge)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    points = np.concatenate(
        [
            [[*(radius[i] * np.sin(a) * ring[k]), radius[i] * np.cos(a)] for k in range(AROUND)]
            for i, a in enumerate(angles)
        ]
    )
    spots = np.concatenate([0.5 + 0.5 * a / FAR * ring * [1, -1] for a in angles])
    quads = between(RINGS, AROUND, is_closed=True)
    shade = 1 - 0.38 * np.clip((points[:, 1] / eye.radius - 0.10) / 0.5, 0, 1) ** 1.2
    shade = shade * (1 - 0.25 * np.clip(np.abs(points[:, 0]) / eye.radius - 0.45, 0, 1))
    moves = {}
    outwards = 1 if side == "Left" else -1
    points = points @ _turn(-outwards * TOE_IN, 0).T
    for name, across, up in (("Up", 0, 1), ("Down", 0, -1), ("Out", outwards, 0), ("In", -outwards, 0)):
        moves[f"eyeLook{name}{side}"] = points @ _turn(across * ACROSS, up * UPWARDS).T - points
    return make(
        points + eye.middle,
        quads,
        body.one("head", len(points)),
        "eye",
        uvs=atlas.within(atlas.EYE, spots)[quads],
        colours=np.repeat(shade[:, None], 3, 1),
        moves=moves,
    )


def _turn(across: float, up: float) -> Float[np.ndarray, "3 3"]:
    c, s, d, t = np.cos(across), np.sin(across), np.cos(up), np.sin(up)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, d, t], [0, -t, d]])


def paint_eye(person: Person, size: int) -> Float[np.ndarray, "s s 3"]:
    """The picture on the eyeball in sRGB: sclera with veins, limbal ring, iris with fibres, pupil."""
    rng = np.random.default_rng(11)
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, at)
    angle = np.hypot(x, y) * FAR / IRIS  # 1 at the edge of the iris
    turn = np.arctan2(y, x)
    white = np.array([0.76, 0.735, 0.715]) * np.ones((size, size, 3))
    veins = gaussian_filter(rng.standard_normal((size, size)), 2.2)
    veins = np.clip(1 - np.abs(veins) / veins.std() * 4.5, 0, 1) * np.clip((angle - 1.5) / 1.6, 0, 1)
    white = white * (1 - veins[..., None] * np.array([0.03, 0.20, 0.20]))
    white = white * (1 - np.clip((angle - 1.6) / 2.2, 0, 1)[..., None] * np.array([0.05, 0.20, 0.22]))
    iris = np.array(person.iris) / 255
    fibres = np.zeros((size, size))
    for count, weight in ((37, 0.30), (83, 0.35), (151, 0.35)):
        phase = rng.uniform(0, 2 * np.pi, 4)
        wave = np.cos(count * turn + phase[0] + 1.3 * np.sin(3 * angle + phase[1]) + 1.5 * np.sin(5 * turn + phase[2]))
        fibres += weight * wave
    ring = np.exp(-(((angle - 0.47) / 0.13) ** 2))
    tone = iris * (0.95 + 0.40 * fibres[..., None] * np.clip((angle - 0.2) / 0.3, 0, 1)[..., None])
    tone = tone * (1 + ring[..., None] * np.array([0.45, 0.33, 0.18]))
    lower = 1 + 0.35 * np.clip(y / (IRIS / FAR), -1, 1)  # light falls in from above and meets the iris below
    tone = tone * lower[..., None] * (1 - 0.72 * np.clip((angle - 0.74) / 0.26, 0, 1) ** 1.6)[..., None]
    edge = np.clip((angle - 0.955) / 0.11, 0, 1)
    edge = (edge * edge * (3 - 2 * edge))[..., None]
    colour = tone * (1 - edge) + white * edge
    pupil = np.clip((angle - 0.335) / 0.05, 0, 1)[..., None]
    colour = 0.012 + (colour - 0.012) * pupil
    shine = np.hypot(x / (IRIS / FAR) + 0.30, y / (IRIS / FAR) + 0.24)  # a window's light, which life needs
    colour = colour + (0.97 - colour) * np.clip(1.6 - shine / 0.115, 0, 1)[..., None] * 0.9
    return np.clip(colour, 0, 1)


def lashes(body: Body, side: str) -> Surface:
    """Lashes of the upper lid: a dark line at its edge that ends in curved, tapering strands."""
    rng = np.random.default_rng(3)
    base, eye = load_base(), body.eyes[side]
    group = f"helper-{side[0].lower()}-eyelashes-2"
    roots, tips = lash_lines(body, side)
    points: list[Float[np.ndarray, " 3"]] = []
    quads: list[list[int]] = []

    def add(corners: list[Float[np.ndarray, " 3"]], order: list[tuple[int, ...]]) -> None:
        quads.extend([[len(points) + i for i in quad] for quad in order])
        points.extend(corners)

    line = []
    for share in np.linspace(0, 1, LINE + 1):
        root, tip = _along(roots, 0.02 + 0.96 * share), _along(tips, 0.02 + 0.96 * share)
        line += [root, root + (tip - root) * np.interp(share, [0, 0.3, 0.8, 1], [0.08, 0.22, 0.30, 0.16])]
    add(line, [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(LINE)])
    for i in range(STRANDS if body.person.lash_length else 0):
        share = (i + rng.uniform(0.3, 0.7)) / STRANDS
        before, after = (_along(roots, np.clip(0.03 + 0.95 * share + d, 0, 1)) for d in (-BASE, BASE))
        root = (before + after) / 2
        tip = _along(tips, np.clip(0.05 + 0.95 * share + rng.normal(0, 0.012), 0, 1))
        reach = rng.uniform(0.72, 1.0) * np.interp(share, [0, 0.5, 1], [0.55, 0.8, 0.95]) * body.person.lash_length
        curl = np.array([0, 0.0016, 0.0010]) * reach
        end = root + (tip - root) * reach + curl * 0.6
        lift = (end - root) / 2 - curl * [0.3, 0.6, -0.6]
        add([before, after, after + lift + (root - after) * 0.45, before + lift + (root - before) * 0.45, end],
            [(0, 1, 2, 3), (3, 2, 4, 4)])  # fmt: skip
    places = np.array(points)
    away = places - eye.middle
    lift = LIFT if body.person.lash_length else -LIFT  # a line without strands lies below the lid, or looks dotted
    places = places + lift * away / np.linalg.norm(away, axis=1, keepdims=True)
    owner = base.vertices_of(group)
    distance, near = cKDTree(body.points[owner]).query(places, 4)
    share = 1 / (distance + 1e-5)
    share /= share.sum(1, keepdims=True)
    moves = {}
    for name in ARKIT_NAMES:
        move = body.move(name)[owner]
        if np.abs(move).max() > 1e-5:
            moves[name] = np.einsum("vn,vni->vi", share, move[near])
    corners = np.array(quads)
    spots = np.tile(atlas.within(atlas.LASH, np.array([[0.5, 0.5]])), (len(corners), 4, 1))
    out = places - eye.middle
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return make(places, corners, body.one("head", len(places)), "lash", uvs=spots, moves=moves, normals=out)


def lash_lines(body: Body, side: str) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]]:
    """Roots and tips of the upper lid's lashes, from the inner to the outer corner."""
    base, eye = load_base(), body.eyes[side]
    rim = np.unique(border(base.quads[base.groups[f"helper-{side[0].lower()}-eyelashes-2"]]))
    far = np.linalg.norm(body.points[rim] - eye.middle, axis=1) / eye.radius
    roots, tips = (_ordered(body.points[rim[chosen]], eye) for chosen in (far < 1.10, far > 1.20))
    return roots, tips


def _ordered(points: Float[np.ndarray, "n 3"], eye: Eye) -> Float[np.ndarray, "n 3"]:
    """Points of a lid's edge from its inner to its outer corner."""
    return points[np.argsort(points[:, 0] * np.sign(eye.middle[0]))]


def _along(line: Float[np.ndarray, "n 3"], share: float) -> Float[np.ndarray, " 3"]:
    length = np.concatenate([[0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
    return np.array([np.interp(share * length[-1], length, line[:, i]) for i in range(3)])
