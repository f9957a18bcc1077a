"""Hair: ribbons of strands that grow from the scalp, follow it and fall; a painted cap closes what they leave open."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from .base import load_base, mask
from .body import Body
from .person import Person
from .surface import Surface, make, normals, part, smoothed, subdivided

STRIPS = 4  # kinds of strands side by side in the picture: ribbons, and last those of the cap
COMB = 0.40  # radians round the head that a strip of the cap covers
FRINGE = 0.028  # metres above the hairline over which the cap becomes dense
BUN = np.array([0.0, 0.012, -0.165])  # from between the eyes, in metres
APART = 0.006  # metres that a ribbon may hang farther out than its neighbours
AXIS = -0.085  # of the head: its z from between the eyes
PART = 0.022  # metres: where hair parts, on the left


class Layer(NamedTuple):
    """Ribbons of one kind."""

    ribbons: int
    lift: tuple[float, float]  # metres above the scalp at root and tip
    width: float
    length: tuple[float, float]  # metres, or 1 for as far as the style says


STYLES = {
    "bob": (
        Layer(250, (0.003, 0.006), 0.024, (0.95, 1.0)),
        Layer(230, (0.005, 0.010), 0.020, (0.92, 1.0)),
        Layer(170, (0.006, 0.013), 0.012, (0.88, 1.0)),
    ),
    "bun": (Layer(260, (0.004, 0.006), 0.020, (1.0, 1.0)), Layer(240, (0.005, 0.007), 0.014, (0.9, 1.0))),
    "short": (Layer(640, (0.002, 0.006), 0.010, (0.038, 0.052)), Layer(640, (0.003, 0.010), 0.0065, (0.040, 0.060))),
}


# Degrees round the head from the front, and metres above the eyes: the line from which hair grows.
HAIRLINES = {
    "bob": (
        (0, 18, 34, 46, 58, 70, 80, 90, 104, 125, 150, 180),
        (0.070, 0.070, 0.067, 0.057, 0.044, 0.020, 0.004, 0.012, 0.0, -0.048, -0.072, -0.076),
    ),
    "bun": (
        (0, 16, 30, 42, 54, 64, 72, 80, 90, 104, 125, 150, 180),
        (0.066, 0.067, 0.066, 0.058, 0.040, 0.018, -0.004, -0.004, 0.012, 0.0, -0.040, -0.062, -0.066),
    ),
    "short": (  # receding temples and sideburns
        (0, 14, 28, 40, 50, 58, 64, 71, 77, 83, 88, 104, 125, 150, 180),
        (0.066, 0.067, 0.070, 0.071, 0.062, 0.045, 0.022, -0.004, -0.022, -0.022, 0.010, 0.002, -0.034, -0.052, -0.055),
    ),
}


def hairline(points: Float[np.ndarray, "v 3"], body: Body) -> Float[np.ndarray, " v"]:
    """Height above the hairline in metres: above 0 grows hair."""
    eye = (body.eyes["Left"].middle + body.eyes["Right"].middle) / 2
    around = np.degrees(np.arctan2(np.abs(points[:, 0] - eye[0]), points[:, 2] - eye[2] - AXIS))
    return points[:, 1] - eye[1] - np.interp(around, *HAIRLINES[body.person.hair_style])


def scalp_share(body: Body, points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " v"]:
    """How much the skin is below hair, fading over the hairline; ears are free."""
    high = points[:, 1] > body.joint("head")[1] - 0.07
    inside = hairline(points, body) - 0.5 * _bare_temples(points, body)
    return np.clip(0.5 + inside / 0.020, 0, 1) * high * (1 - _ears(body, len(points)))


def _ears(body: Body, count: int) -> Float[np.ndarray, " v"]:
    base = load_base()
    members = base.groups["body"]
    uv = base.uvs[base.uv_quads[members]]
    picture = mask("ears")
    high, wide = picture.shape
    rows = np.clip(((1 - uv[..., 1]) * high).astype(int), 0, high - 1)
    columns = np.clip((uv[..., 0] * wide).astype(int), 0, wide - 1)
    share = np.zeros(count)
    np.maximum.at(share, base.quads[members].ravel(), picture[rows, columns].ravel())
    return share


class Scalp:
    """The head without ears as a smooth shape to grow on, with distances to it and to the shoulders."""

    def __init__(self, body: Body, skin: Surface) -> None:
        head = skin.positions[:, 1] > body.joint("neck")[1] - 0.16
        near = np.abs(skin.positions[:, 0]) < 0.30
        piece = part(skin, (head & near)[skin.quads].all(1))
        ears = _ears(body, len(skin.positions))[np.unique(skin.quads[(head & near)[skin.quads].all(1)])]
        smooth = smoothed(piece.positions, piece.quads, 60, np.clip(ears * 3, 0, 1))
        piece = subdivided(replace(piece, positions=smooth))
        self.points, self.quads = piece.positions, piece.quads
        self.normals = normals(self.points, self.quads)
        self._tree = cKDTree(self.points)

    def near(self, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Signed distance and outward direction."""
        distance, index = self._tree.query(points, 3)
        share = 1 / (distance + 1e-4)
        share /= share.sum(1, keepdims=True)
        out = np.einsum("nk,nki->ni", share, self.normals[index])
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        height = np.einsum("nk,nki,nki->n", share, points[:, None] - self.points[index], self.normals[index])
        return height, out


def hair(body: Body, skin: Surface) -> list[Surface]:
    """The cap and the ribbons of the person's style."""
    scalp = Scalp(body, skin)
    rng = np.random.default_rng(17)
    made = [_cap(body, scalp)]
    for layer in STYLES[body.person.hair_style]:
        made.append(_ribbons(body, scalp, layer, rng))
    if body.person.hair_style == "bun":
        made.append(_bun(body, scalp))
    return made


def _bun(body: Body, scalp: Scalp) -> Surface:
    """A coil of ribbons round the place where pulled hair meets."""
    eye = (body.eyes["Left"].middle + body.eyes["Right"].middle) / 2
    rng = np.random.default_rng(29)
    _, index = cKDTree(scalp.points).query((eye + BUN)[None])
    out = scalp.normals[index[0]]
    middle = scalp.points[index[0]] + out * 0.020
    side = np.array([1.0, 0, 0])
    up = np.cross(out, side)
    lines, outs = [], []
    for _ in range(90):
        tilt, start = rng.uniform(-1.2, 1.2), rng.uniform(0, 2 * np.pi)
        turn = start + np.linspace(0, 2.4, 9)
        ring = 0.036 * np.cos(tilt * 0.75) * rng.uniform(0.94, 1.05)
        height = 0.026 * np.sin(tilt) + 0.004 * np.sin(2 * turn + start)
        line = middle + ring * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up) + height[:, None] * out
        lines.append(line)
        away = line - middle + 0.006 * out
        outs.append(away / np.linalg.norm(away, axis=1, keepdims=True))
    return _strip(body, np.array(lines), np.array(outs), Layer(90, (0, 0), 0.016, (1, 1)), rng)


def _cap(body: Body, scalp: Scalp) -> Surface:
    """What closes the gaps between ribbons: strands combed along the style, which end in a fringe at the hairline."""
    height = hairline(scalp.points, body)
    inside = height > _bare_temples(scalp.points, body) - 0.004
    surface = make(scalp.points, scalp.quads, body.one("head", len(scalp.points)), "hair")
    piece = part(surface, inside[scalp.quads].all(1))
    height = hairline(piece.positions, body)
    up = np.clip(height / 0.03, 0, 1)
    out = normals(piece.positions, piece.quads)
    points = piece.positions + out * (0.0008 + 0.0042 * up)[:, None]
    eye = (body.eyes["Left"].middle + body.eyes["Right"].middle) / 2
    side, above, _ = (points - eye - (BUN if body.person.hair_style == "bun" else [0.0, 0.02, 0.0])).T
    turn = np.arctan2(side, above)  # hair is combed from the front to the back
    across = np.abs((turn / COMB) % 2 - 1)  # there and back, or strips would end in seams
    share = 0.62 * np.clip(height / FRINGE, 0, 1) + 0.36 * np.clip((height - FRINGE) / 0.1, 0, 1)
    uvs = np.stack([(STRIPS - 1 + 0.03 + 0.94 * across) / STRIPS, 0.01 + share], 1)[piece.quads]
    tint = np.full((len(points), 3), 0.84)
    return make(points, piece.quads, body.one("head", len(points)), "hair", uvs=uvs, colours=tint, normals=out)


def _bare_temples(points: Float[np.ndarray, "v 3"], body: Body) -> Float[np.ndarray, " v"]:
    """Metres above the hairline that a bob leaves bare: its hair falls past the temples, where roots look like dirt."""
    if body.person.hair_style != "bob":
        return np.zeros(len(points))
    rel = points - (body.eyes["Left"].middle + body.eyes["Right"].middle) / 2
    around = np.degrees(np.arctan2(np.abs(rel[:, 0]), rel[:, 2] - AXIS))
    return np.asarray(np.interp(around, [32, 40, 80, 95], [0.0, 0.016, 0.016, 0.0]))


def _ribbons(body: Body, scalp: Scalp, layer: Layer, rng: np.random.Generator) -> Surface:
    """All ribbons of a layer, grown side by side."""
    roots, out = _roots(body, scalp, layer.ribbons, rng)
    style = body.person.hair_style
    eye = (body.eyes["Left"].middle + body.eyes["Right"].middle) / 2
    lengths = rng.uniform(*layer.length, layer.ribbons)
    jitter = rng.normal(0, 1, (layer.ribbons, 3))
    phase = rng.uniform(0, 2 * np.pi, layer.ribbons)
    steps = 9 if style != "short" else 4
    fine = 3  # steps on the way for each point that is kept
    lower = np.interp(roots[:, 1] - eye[1], [-0.05, 0.0, 0.05], [0.3, 0.45, 1.0]) if style == "short" else 1.0
    front = HAIRLINES[style][1][0]
    at = roots + out * layer.lift[0] * rng.uniform(0.1, 0.4, (layer.ribbons, 1))
    lines, outs = [at], [out]
    direction = _flow(style, roots, out, eye, jitter)
    end = _ends(style, roots, eye, lengths, rng)
    for step in range(1, (steps - 1) * fine + 1):
        height, out = scalp.near(at)
        wish = _flow(style, at, out, eye, jitter * (0.35 if style != "short" else 1))
        direction = 0.75 * direction + 0.25 * wish
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        pace = end / ((steps - 1) * fine)
        at = at + direction * pace[:, None]
        height, out = scalp.near(at)
        share = step / ((steps - 1) * fine)
        wanted = layer.lift[0] + (layer.lift[1] - layer.lift[0]) * np.sin(share * np.pi * 0.5)
        wanted = (wanted * (0.3 + 0.7 * min(1, share / 0.2)) + 0.0012 * np.sin(3 * share + phase)) * lower
        push = np.maximum(wanted - height, 0)
        held = np.where(at[:, 1] > eye[1] - 0.01, 0.35, 0) if style != "short" else 0.6 - 0.5 * lower
        pull = np.minimum(wanted * 1.6 - height, 0) * held
        at = at + out * (push + pull)[:, None]
        if step % fine == 0:
            lines.append(at)
            outs.append(out)
    grown = np.stack(lines, 1)
    free = ~_on_face(grown, eye, front + (0.004 if style == "short" else -0.008)).any(1)
    if style == "short":  # cut round the ears
        free &= (hairline(roots, body) > 0.007) | (roots[:, 1] > eye[1] + 0.02)  # a nape is shaved
        rel = np.abs(grown - eye)
        free &= ~((rel[..., 0] > 0.062) & (grown[..., 1] < eye[1] + 0.014) & (rel[..., 2] < 0.125)).any(1)
    if style == "bob":
        rel = _gathered(grown - eye)
        free &= ~((rel[..., 1] < 0.0) & (rel[..., 2] > -0.045)).any(1)  # single ones before the others are like wires
        grown = rel + eye
    return _strip(body, grown[free], np.stack(outs, 1)[free], layer, rng)


def _gathered(rel: Float[np.ndarray, "n s 3"]) -> Float[np.ndarray, "n s 3"]:
    """Ribbons of which none hangs apart from those beside it, like a wire; places are from between the eyes."""
    x, y, z = np.moveaxis(rel, -1, 0)
    far, turn = np.hypot(x, z - AXIS), np.arctan2(x, z - AXIS)
    cells = np.stack([np.floor(turn / 0.25), np.floor(y / 0.02)], -1).reshape(-1, 2)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(far.shape)
    usual = np.array([np.median(far[cell == each]) for each in range(cell.max() + 1)])
    beyond = np.maximum(far - usual[cell] - APART, 0) * np.clip(1.7 - y / 0.03, 0, 1)
    shrunk = 1 - gaussian_filter(beyond, (0, 1)) / far
    return np.stack([x * shrunk, y, (z - AXIS) * shrunk + AXIS], -1)


def _on_face(points: Float[np.ndarray, "n s 3"], eye: Float[np.ndarray, " 3"], high: float) -> Bool[np.ndarray, "n s"]:
    """Whether points hang before forehead (`high` metres above the eyes), eyes or cheeks."""
    rel = points - eye
    below = rel[..., 1] < high - 9 * rel[..., 0] ** 2
    return below & (rel[..., 2] > -0.062) & (np.abs(rel[..., 0]) < 0.088)


def _roots(
    body: Body, scalp: Scalp, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Random places on the scalp, more along hairline and part."""
    height = hairline(scalp.points, body)
    quads = scalp.quads[(height[scalp.quads] > 0.001).all(1)]
    corner = scalp.points[quads]
    area = np.linalg.norm(np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]), axis=1)
    middle = height[quads].mean(1)
    part_line = np.exp(-np.abs(corner[:, :, 0].mean(1) - PART) / 0.010) * (middle > 0.02)
    area = area * (1 + 1.6 * np.exp(-middle / 0.012) + (2.5 * part_line if body.person.hair_style == "bob" else 0))
    chosen = rng.choice(len(quads), count, p=area / area.sum())
    u, v = rng.uniform(0, 1, (2, count, 1))
    c = corner[chosen]
    points = (c[:, 0] * (1 - u) + c[:, 1] * u) * (1 - v) + (c[:, 3] * (1 - u) + c[:, 2] * u) * v
    if body.person.hair_style == "bob":  # hair of both sides meets at the part
        by_part = (np.abs(points[:, 0] - PART) < 0.014) & (points[:, 1] > body.eyes["Left"].middle[1] + 0.07)
        side = np.sign(points[by_part, 0] - PART)
        points[by_part, 0] = PART + side * rng.uniform(0.0001, 0.002, by_part.sum())
    _, out = scalp.near(points)
    return points, out


def _flow(
    style: str,
    at: Float[np.ndarray, "n 3"],
    out: Float[np.ndarray, "n 3"],
    eye: Float[np.ndarray, " 3"],
    jitter: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Where hair wants to go from here, unit, mostly along the scalp."""
    rel = at - eye
    side = np.sign(rel[:, 0] - PART)
    top = np.clip((rel[:, 1] - 0.05) / 0.06, 0, 1)
    if style == "bob":
        front = np.clip((rel[:, 2] + 0.05) / 0.05, 0, 1) * (rel[:, 1] > -0.01)
        wish = np.stack([side * (0.25 + 1.1 * top), -1.0 + 0.55 * top, -0.18 - 0.40 * front], 1)
        wish[:, 0] -= np.sign(rel[:, 0]) * 0.35 * np.clip((-0.035 - rel[:, 1]) / 0.05, 0, 1)
        wish += 0.05 * jitter
    elif style == "bun":
        goal = BUN - rel
        wish = goal / np.linalg.norm(goal, axis=1, keepdims=True) + 0.02 * jitter
    else:
        back = np.clip(-(rel[:, 2] + 0.10) / 0.05, 0, 1)
        wish = np.stack(
            [0.10 * np.sign(rel[:, 0]) * (1 - top) - 0.55 * top, -0.75 * (1 - top) - 0.25 * back, -0.55 - 0.15 * top], 1
        )
        brow = (top * np.clip((rel[:, 2] + 0.05) / 0.04, 0, 1))[:, None]
        wish += brow * [0.30, 0.55, 0.10]  # brushed up over the forehead
        wish += 0.07 * jitter + out * 0.12 * (top * (1 - back))[:, None]
        return wish / np.linalg.norm(wish, axis=1, keepdims=True)
    wish = wish - out * np.einsum("ni,ni->n", wish, out)[:, None] * 0.9
    return wish / np.linalg.norm(wish, axis=1, keepdims=True)


def _ends(
    style: str,
    roots: Float[np.ndarray, "n 3"],
    eye: Float[np.ndarray, " 3"],
    lengths: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    """How long each ribbon is, in metres."""
    rel = roots - eye
    if style == "short":
        return lengths * np.interp(rel[:, 1], [-0.06, -0.01, 0.03, 0.07], [0.22, 0.30, 0.55, 1.0])
    if style == "bun":
        return np.linalg.norm(BUN - rel, axis=1) * 1.22 * lengths
    bottom = -0.078 - 0.012 * np.clip(-rel[:, 2] / 0.15, 0, 1)
    side = np.abs(np.where(rel[:, 1] > 0.05, 0.085 - np.abs(rel[:, 0]), 0)).clip(0)
    return (rel[:, 1] - bottom + 0.75 * side).clip(0.03) * lengths + rng.normal(0, 0.004, len(roots))


def _strip(
    body: Body,
    lines: Float[np.ndarray, "n s 3"],
    outs: Float[np.ndarray, "n s 3"],
    layer: Layer,
    rng: np.random.Generator,
) -> Surface:
    """Ribbons along lines; their normals are those of the head, so that light falls on hair as on one volume."""
    count, steps = lines.shape[:2]
    along = np.gradient(lines, axis=1)
    across = np.cross(along, outs)
    across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-9)
    share = np.linspace(0, 1, steps)
    root = 0.20 if body.person.hair_style == "short" else 0.75
    shape = np.interp(share, [0, 0.15, 0.6, 1], [root, 1.0, 1.0, 0.62])
    tilt = rng.uniform(-0.35, 0.35, (count, 1, 1))
    half = across * (layer.width / 2 * rng.uniform(0.75, 1.2, (count, 1, 1))) * shape[None, :, None]
    lean = outs * tilt * layer.width * 0.4
    points = np.stack([lines - half - lean, lines + half + lean], 2).reshape(-1, 3)
    index = np.arange(count * steps * 2).reshape(count, steps, 2)
    quads = np.stack([index[:, :-1, 0], index[:, :-1, 1], index[:, 1:, 1], index[:, 1:, 0]], -1).reshape(-1, 4)
    strip = rng.integers(0, STRIPS - 1, (count, 1))
    flip = rng.integers(0, 2, count)
    left = (strip + np.array([[0.03, 0.97], [0.97, 0.03]])[flip]) / STRIPS
    uvs = np.zeros((count, steps, 2, 2))
    uvs[..., 0] = left[:, None, :]
    uvs[..., 1] = (0.02 + 0.96 * share)[None, :, None]
    spots = uvs.reshape(-1, 2)[quads]
    facing = outs + 0.25 * np.concatenate([np.zeros_like(along[..., :1]), along[..., 1:] * 0], 2)
    bright = (0.72 + 0.28 * np.sin(share * np.pi * 0.8 + 0.35))[None, :, None] * rng.uniform(0.88, 1.10, (count, 1, 1))
    shine = np.exp(-(((outs @ [0.10, 0.78, 0.62] - 0.93) / 0.07) ** 2))  # the ring of light on smooth hair
    bright = bright * (1 + 0.45 * shine[..., None])
    tint = np.repeat(np.broadcast_to(bright, (count, steps, 2)).reshape(-1, 1), 3, 1)
    spread = np.stack([facing - 0.28 * across, facing + 0.28 * across], 2).reshape(-1, 3)
    spread /= np.linalg.norm(spread, axis=1, keepdims=True)
    return make(points, quads, body.one("head", len(points)), "hair", uvs=spots, colours=tint, normals=spread)


def paint_hair(person: Person, size: int = 512) -> Float[np.ndarray, "s s 4"]:
    """Colour (sRGB) and alpha of the ribbons: roots at the top, strands that part towards the tips."""
    rng = np.random.default_rng(23)
    shade = np.zeros((size, size))
    alpha = np.zeros((size, size))
    wide = size // STRIPS
    v = np.linspace(0, 1, size)
    columns = np.arange(size)
    for strip in range(STRIPS - 1):
        for _ in range(110):
            at = rng.normal(0.5, 0.23)
            if not 0.06 < at < 0.94:
                continue
            drift = rng.normal(0, 0.05) * v**1.5 + 0.012 * np.sin(v * rng.uniform(4, 12) + rng.uniform(0, 6))
            spread = (at - 0.5) * (0.80 + 0.25 * v)
            x = (strip + np.clip(0.5 + spread + drift, 0.03, 0.97)) * wide
            thick = rng.uniform(1.0, 2.3) * np.interp(v, [0, 0.7, 1], [1, 1, 0.45])
            stop, start = rng.uniform(0.82, 1.0), rng.uniform(0, 0.12)
            body = np.clip((stop - v) / 0.05, 0, 1) * np.clip((v - start) / 0.02, 0, 1)
            cover = np.clip(thick[:, None] + 0.5 - np.abs(columns[None] + 0.5 - x[:, None]), 0, 1) * body[:, None]
            tone = rng.normal(1.0, 0.12) * (1 + 0.10 * np.sin(v * 9 + rng.uniform(0, 6)))
            shade = shade + (tone[:, None] - shade) * cover
            alpha = np.maximum(alpha, cover)
    tones = gaussian_filter(rng.normal(0, 1, wide), 0.7)
    starts = gaussian_filter(rng.uniform(-0.1, 0.65, wide), 0.6)
    shade[:, -wide:] = 1 + 0.06 * tones / tones.std() + 0.05 * np.sin(v * 9)[:, None]
    alpha[:, -wide:] = np.clip((v[:, None] - starts) / 0.10, 0, 1)
    under = gaussian_filter(np.where(alpha > 0.3, shade, 0), 3) / np.maximum(
        gaussian_filter((alpha > 0.3) * 1.0, 3), 1e-3
    )
    shade = np.where(alpha > 0.05, shade, under)
    colour = np.clip(np.array(person.hair) / 255 * shade[..., None] * 1.15, 0, 1)
    return np.concatenate([colour, alpha[..., None]], 2)
