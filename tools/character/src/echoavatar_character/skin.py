"""The skin: which part of the body is seen, and the picture on it, painted by where in space each texel lies."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from echoavatar.motion.arkit import ARKIT_NAMES

from . import atlas, fit
from .base import load_base, mask
from .body import Body
from .eyes import lash_lines
from .fabric import normal_map
from .surface import Surface, make, normals, part, smoothed

Field = Float[np.ndarray, "..."]
HANDS = ("Hand", "Thumb", "Index", "Middle", "Ring", "Little")
BULGE = {"mouthSmile": 4.0, "cheekSquint": 2.0, "eyeSquint": 0.3}  # millimetres that the cheek rises besides
HIDDEN = 0.006  # metres that skin sinks below the collar, or it comes through
ROUGH = 0.64  # of skin that does not shine
RELIEF = 1.5  # texels, of a height of 1
BARE = 0.7  # as long as these lashes is the line of an eye whose own are only painted
LINER = 0.0011  # metres: half the width of the dark line that lashes make on the lid
BROW_PIXELS = 9000  # a metre, in the picture of the brows


def whole_skin(body: Body) -> Surface:
    """The body as a surface with its place in the atlas and all face curves."""
    base = load_base()
    quads = base.groups["body"]
    uvs = base.uvs[base.uv_quads[quads]]
    flipped = np.stack([uvs[..., 0], 1 - uvs[..., 1]], -1)
    count = int(base.quads[quads].max()) + 1
    moves = {name: body.move(name)[:count] for name in ARKIT_NAMES}
    for name in ARKIT_NAMES:  # the creases of a full smile are sharper than the mesh
        if "Smile" in name or "Squint" in name:
            moves[name] = smoothed(moves[name], base.quads[quads], 3, 0.45)
            rise = BULGE[name.removesuffix("Left").removesuffix("Right")]
            moves[name] = moves[name] + rise * _apple(body, name, count)
    return make(
        body.points[:count], base.quads[quads], body.weights[:count], "skin", uvs=atlas.placed(flipped), moves=moves
    )


def _apple(body: Body, curve: str, count: int) -> Float[np.ndarray, "v 3"]:
    """What lifts the apple of the cheek on the curve's side by a millimetre."""
    points, side = body.points[:count], 1 if curve.endswith("Left") else -1
    eye, mouth = body.eyes["Left"].middle, body.middle("joint-mouth")
    place = np.array([side * eye[0] * 1.12, mouth[1] + 0.52 * (eye[1] - mouth[1]), 0])
    far = ((points - place) / [0.017, 0.015, 1])[:, :2]
    share = np.exp(-(far**2).sum(1)) * (points[:, 2] > eye[2] - 0.03)
    out = np.array([0.45 * side, 0.35, 0.82])
    return np.asarray(0.001 * share[:, None] * out)


def seen_skin(skin: Surface, body: Body, neckline: Float[np.ndarray, " v"]) -> Surface:
    """Head, neck and hands, and a little of what is below the hems; `neckline` is the depth below the neckline."""
    share = {name: skin.weights[:, j] for j, name in enumerate(fit.NAMES)}
    hand = sum(share[name] for name in fit.NAMES if any(part in name for part in HANDS))
    wrist = np.zeros(len(skin.positions))
    for side in ("left", "right"):
        elbow, end = body.joint(side + "LowerArm"), body.joint(side + "Hand")
        along = (end - elbow) / np.linalg.norm(end - elbow)
        near = share[side + "LowerArm"] > 0.02
        wrist = np.where(near, np.maximum(wrist, ((skin.positions - end) @ along > -0.05).astype(float)), wrist)
    neck = np.hypot(skin.positions[:, 0], skin.positions[:, 2] - body.joint("neck")[2]) < 0.105
    bare = (neckline < 0.02) & (neck | (share["head"] + share["neck"] > 0.3))
    keep = bare | (hand > 0.5) | (wrist > 0)
    inwards = HIDDEN * np.clip(neckline / 0.012, 0, 1) * neck
    sunk = skin.positions - normals(skin.positions, skin.quads) * inwards[:, None]
    still = skin.weights.copy()  # as the collar, which no arm moves
    for side in ("left", "right"):
        arm = fit.NAMES.index(side + "UpperArm")
        still[neck, fit.NAMES.index("upperChest")] += still[neck, arm]
        still[neck, arm] = 0
    return part(replace(skin, positions=sunk, weights=still), keep[skin.quads].any(1))


def paint(body: Body, skin: Surface, scalp: Field, size: int = atlas.SIZE) -> Float[np.ndarray, "h w 3"]:
    """The skin's colour in sRGB, 0 to 1. `scalp` is 1 at vertices below hair."""
    points, uv, more = _texels(skin, size, scalp[:, None])
    under_hair = more[..., 0]
    colour = _tone(body, points, uv)
    colour = colour * (1 - _liner(body, points)[..., None] * [0.80, 0.86, 0.88])
    brows = _brows(body, points)
    hair = np.array(body.person.hair) / 255
    colour = colour + (hair * 0.8 - colour) * brows[..., None]
    grown = np.clip(under_hair * 1.5 - 0.45, 0, 1)
    grown = grown * (1 + 0.6 * (1 - grown) * atlas.noise(points * [1, 0.5, 0.5], 0.0009, 8))
    strength = np.clip(grown * grown * (3 - 2 * grown), 0, 1)[..., None] * 0.85
    colour = colour + (hair * 0.62 - colour) * strength
    return np.asarray(np.clip(colour, 0, 1))


def roughness(body: Body, skin: Surface, scalp: Field, size: int = 512) -> Float[np.ndarray, "h w"]:
    """How rough the skin is, 0 to 1: lips, nails, lids, brow and nose shine more than the rest, painted hair less."""
    points, uv, under_hair = _texels(skin, size, scalp[:, None])
    eye, nose, mouth = body.eyes["Left"].middle, _nose(body), body.middle("joint-mouth")
    front = np.clip((points[..., 2] - eye[2] + 0.03) / 0.03, 0, 1) * (points[..., 1] > mouth[1] - 0.08)
    brow = np.exp(-((points[..., 0] / 0.035) ** 2) - ((points[..., 1] - eye[1] - 0.055) / 0.025) ** 2)
    ridge = np.exp(-((points[..., 0] / 0.012) ** 2) - ((points[..., 1] - (eye[1] + nose[1]) / 2) / 0.03) ** 2)
    rough = ROUGH - 0.14 * front * np.maximum(brow, ridge) - 0.06 * _sample(mask("eyelids"), uv)
    for name, wet in (("lips", 0.36), ("fingernails", 0.34)):
        share = np.clip(_sample(gaussian_filter(mask(name), 1.2), uv), 0, 1)
        rough = rough + (wet - rough) * share
    rough = rough + (1 - rough) * np.clip(under_hair[..., 0] * 2.0 - 0.45, 0, 1)
    return np.asarray(np.clip(rough + 0.03 * atlas.noise(points, 0.004, 9), 0, 1))


def relief(body: Body, skin: Surface, scalp: Field, size: int = 1024) -> Float[np.ndarray, "h w 3"]:
    """The skin's normal map, as colours 0 to 1: pores and fine creases, and the lines of the lips."""
    points, uv, under_hair = _texels(skin, size, scalp[:, None])
    lips = np.clip(_sample(gaussian_filter(mask("lips"), 1.2), uv), 0, 1)
    bare = np.clip(1 - 2.5 * under_hair[..., 0], 0, 1) * (1 - lips)
    pores = 0.55 * atlas.noise(points, 0.0022, 12) + 0.45 * atlas.noise(points, 0.0046, 13)
    lines = atlas.noise(points * [1, 0.25, 0.6], 0.0016, 14)
    heights = gaussian_filter(0.30 * bare * pores + 0.42 * lips * lines, 0.8)
    return normal_map(heights, RELIEF)


def _texels(
    skin: Surface, size: int, more: Float[np.ndarray, "v d"]
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 2"], Float[np.ndarray, "h w d"]]:
    """Where each texel of the atlas lies in space and on the base mesh's UV map, and `more` of the vertices there."""
    base = load_base()
    raw = base.uvs[base.uv_quads[base.groups["body"]]]
    raw = np.stack([raw[..., 0], 1 - raw[..., 1]], -1)
    places, others = (atlas.corners(values[skin.quads]) for values in (skin.positions, more))
    spread, covered = atlas.spread(
        atlas.corners(skin.uvs), np.concatenate([places, atlas.corners(raw), others], 2), size
    )
    spread = atlas.filled(spread, covered)
    return spread[..., :3], spread[..., 3:5], spread[..., 5:]


def _tone(body: Body, points: Float[np.ndarray, "h w 3"], uv: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w 3"]:
    """Skin before hair: blood and melanin, lips, nails, lids, pores."""
    person = body.person
    skin = np.array(person.skin) / 255
    eyes = body.eyes
    mouth, nose = body.middle("joint-mouth"), _nose(body)
    wide = (eyes["Left"].middle[0] - eyes["Right"].middle[0]) / 2
    eye_y = eyes["Left"].middle[1]
    front = np.clip((points[..., 2] - (eyes["Left"].middle[2] - 0.03)) / 0.03, 0, 1) * (
        points[..., 1] > mouth[1] - 0.08
    )

    def spot(x: float, y: float, across: float, high: float) -> Field:
        dx = (np.abs(points[..., 0]) - x) / across
        return np.asarray(front * np.exp(-(dx**2) - ((points[..., 1] - y) / high) ** 2))

    cheek = spot(wide * 1.25, (eye_y + mouth[1]) / 2 - 0.002, 0.020, 0.016)
    tip = front * np.exp(-(((points - nose) / 0.012) ** 2).sum(-1))
    chin = spot(0, mouth[1] - 0.033, 0.014, 0.010)
    below_eye = spot(wide, eye_y - 0.014, 0.016, 0.006)
    ears = _sample(mask("ears"), uv)
    inside = _sample(mask("inside-mouth"), uv)
    nails = _sample(mask("fingernails"), uv)
    lids = _sample(mask("eyelids"), uv)
    lips = np.clip(_sample(gaussian_filter(mask("lips"), 1.2), uv) * 1.15, 0, 1)
    mottle = 0.5 * atlas.noise(points, 0.022, 1) + 0.3 * atlas.noise(points, 0.007, 2)
    pores = atlas.noise(points, 0.0011, 3)
    hand = (np.abs(points[..., 0]) > 0.30).astype(float)
    redness = 0.46 * cheek + 0.34 * tip + 0.18 * chin + 0.22 * ears + 0.10 * mottle + 0.08 * lids + 0.12 * hand
    redness = redness + 0.10 * below_eye * (0.5 + person.lines)
    shadow = 0.16 * lids * (person.lash_length > 0.9)
    colour = skin * (1 - shadow[..., None]) * (1 + 0.018 * pores[..., None] + 0.02 * mottle[..., None])
    blood = np.array([1.0, 0.80, 0.77])
    colour = colour * (1 + (blood - 1) * np.clip(redness, -0.3, 1.2)[..., None])
    lip = np.array(person.lips) / 255 * (1 + 0.05 * atlas.noise(points * [1, 0.25, 1], 0.0012, 4)[..., None])
    colour = colour + (lip - colour) * (lips * 0.82)[..., None]
    colour = colour + (skin * [1.04, 0.93, 0.92] - colour) * (nails * 0.8)[..., None]
    gum = np.array([0.48, 0.20, 0.20])
    return np.asarray(colour + (gum - colour) * inside[..., None])


def _nose(body: Body) -> Float[np.ndarray, " 3"]:
    """The tip of the nose."""
    eye, mouth = body.eyes["Left"].middle, body.middle("joint-mouth")
    points = body.points[load_base().vertices_of("body")]
    near = (points[:, 1] < eye[1]) & (points[:, 1] > mouth[1]) & (np.abs(points[:, 0]) < 0.01)
    return np.asarray(points[near][points[near, 2].argmax()])


def brow_curve(body: Body, share: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """The left brow from its inner (0) to its outer end (1): middle line in x and y, and half its height."""
    eye = body.eyes["Left"]
    x = eye.middle[0] + np.interp(share, [0, 1], [-0.0185, 0.0265])
    y = (
        eye.middle[1]
        + body.person.brow_lift
        + np.interp(share, [0, 0.2, 0.45, 0.65, 0.85, 1], [0.0202, 0.0220, 0.0242, 0.0252, 0.0232, 0.0190])
    )
    half = np.interp(share, [0, 0.12, 0.32, 0.65, 1], [0.0006, 0.0018, 0.0026, 0.0021, 0.0006])
    return np.stack([x, y], 1), half * body.person.brow_width


def _brows(body: Body, points: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """How much each texel is covered by the hairs of the brows, drawn as strokes seen from the front."""
    rng = np.random.default_rng(5)
    eye = body.eyes["Left"].middle
    wide, high = 0.07, 0.04
    picture = Image.new("L", (int(wide * BROW_PIXELS), int(high * BROW_PIXELS)))
    draw = ImageDraw.Draw(picture)
    for _ in range(560):
        at = rng.beta(1.25, 1.15)
        place, half = brow_curve(body, np.array([at]))
        root = place[0] + [0, half[0] * rng.uniform(-1, 0.75)]
        ahead, _ = brow_curve(body, np.array([min(at + 0.05, 1)]))
        along = (ahead[0] - place[0]) / max(float(np.linalg.norm(ahead[0] - place[0])), 1e-6)
        up = np.interp(at, [0, 0.25, 0.6, 1], [1.9, 0.9, 0.28, -0.1]) + rng.normal(0, 0.18)
        direction = along + [0, up]
        direction /= np.linalg.norm(direction)
        length = rng.uniform(0.0045, 0.0075) * np.interp(at, [0, 0.25, 1], [0.55, 1, 0.75])
        bend = root + direction * length * 0.55
        end = bend + (direction * 0.6 + along * 0.6) * length * 0.45
        line = [((x - eye[0] + 0.03) * BROW_PIXELS, (0.04 - (y - eye[1])) * BROW_PIXELS) for x, y in (root, bend, end)]
        draw.line(line, fill=int(rng.uniform(140, 250) * np.interp(at, [0, 0.22], [0.5, 1])), width=2)
    soft = gaussian_filter(np.asarray(picture, np.float32) / 255, 1.0)
    base = gaussian_filter(soft, 9)
    cover = np.clip(0.72 * soft + 0.52 * base, 0, 0.84)
    column = (np.abs(points[..., 0]) - eye[0] + 0.03) * BROW_PIXELS
    row = (0.04 - (points[..., 1] - eye[1])) * BROW_PIXELS
    drawn = map_coordinates(cover, [row, column], order=1, cval=0)
    return np.asarray(drawn * (points[..., 2] > eye[2] - 0.012))


def _liner(body: Body, points: Float[np.ndarray, "h w 3"]) -> Field:
    """How dark the roots of the lashes make the edge of the upper lid, 0 to 1."""
    shade = np.zeros(points.shape[:2])
    length = body.person.lash_length or BARE
    for side, eye in body.eyes.items():
        roots, _ = lash_lines(body, side)
        share = np.linspace(0, 1, 80)
        at = np.linspace(0, 1, len(roots))
        line = np.stack([np.interp(share, at, roots[:, i]) for i in range(3)], 1)
        near = np.linalg.norm(points - eye.middle, axis=-1) < 1.7 * eye.radius
        far, which = cKDTree(line).query(points[near])
        wide = LINER * length * np.interp(share[which], [0, 0.3, 0.85, 1], [0.4, 0.8, 1.2, 0.7])
        shade[near] = np.maximum(shade[near], np.clip(1.5 - far / wide, 0, 1))
    return shade * min(1.0, length)


def _sample(picture: Float[np.ndarray, "h w"], uv: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w"]:
    high, wide = picture.shape
    return np.asarray(
        map_coordinates(picture, [uv[..., 1] * high - 0.5, uv[..., 0] * wide - 0.5], order=1, mode="nearest")
    )
