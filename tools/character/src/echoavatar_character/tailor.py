"""The picture of the clothes, painted by where on the body each texel lies: colours, seams, buttons, belts."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from . import atlas
from .body import Body
from .clothes import ARM_NAMES, AXIS, CUTS, HEM, neckline, opening
from .person import Outfit
from .pieces import CHARTS, COLLAR_SPOT
from .surface import Surface

SIZE = 1024
Field = Float[np.ndarray, "h w"]
Picture = Float[np.ndarray, "h w 3"]
BAND = 0.024  # metres of a neckline's and a cuff's border
BELT = (HEM - 0.026, HEM + 0.010)
STRIPE, CHECK, DOT = 0.034, 0.036, 0.018  # metres from one to the next


class Cloth(NamedTuple):
    """Where each texel of a garment lies, in metres, in the modelled pose."""

    body: Body
    worn: Outfit
    points: Float[np.ndarray, "h w 3"]
    arm: Field  # its share of the arms

    @property
    def across(self) -> Field:
        """The distance from the middle plane."""
        return np.abs(self.points[..., 0])

    def flat(self) -> tuple[Field, Field]:
        """Where each texel lies when the cloth is laid flat: metres round trunk or arm, and along it."""
        x, y, z = np.moveaxis(self.points, -1, 0)
        shoulder = self.body.joint("leftUpperArm")
        on_arm = self.arm > 0.5
        turn = np.arctan2(y - np.interp(self.across, [0.17, 0.5], [shoulder[1], shoulder[1] - 0.3]), z - shoulder[2])
        return np.where(on_arm, 0.045 * turn, 0.15 * np.arctan2(x, z - AXIS)), np.where(on_arm, self.along_arm(), y)

    def along_arm(self) -> Field:
        """Metres from the shoulder's joint along upper arm and forearm; below 0 on the trunk's side."""
        left = np.stack([self.across, self.points[..., 1], self.points[..., 2]], -1)
        shoulder, elbow, wrist = (self.body.joint(f"left{name}") for name in ("UpperArm", "LowerArm", "Hand"))
        upper, lower = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
        first, second = (left - shoulder) @ (elbow - shoulder) / upper, (left - elbow) @ (wrist - elbow) / lower
        share = np.clip(0.5 + second / 0.08, 0, 1)
        return np.minimum(first, upper + 0.04) * (1 - share) + (upper + second) * share

    def of_arm(self) -> float:
        """The length of upper arm and forearm."""
        places = [self.body.joint(f"left{name}") for name in ("UpperArm", "LowerArm", "Hand")]
        return float(sum(np.linalg.norm(b - a) for a, b in zip(places, places[1:], strict=False)))


def picture(body: Body, worn: Outfit, pieces: Sequence[Surface], size: int = SIZE) -> Picture:
    """The colours of all garments of an outfit in sRGB, 0 to 1."""
    image, covered = np.full((size, size, 3), 0.5), np.zeros((size, size))
    for piece in pieces:
        if piece.material not in CHARTS:
            continue
        arm = piece.weights[:, ARM_NAMES].sum(1, keepdims=True)
        values = atlas.corners(np.concatenate([piece.positions, arm], 1)[piece.quads])
        drawn, here = atlas.spread(atlas.corners(piece.uvs), values, size)
        painted = PAINTERS[piece.material](Cloth(body, worn, drawn[..., :3], drawn[..., 3]))
        image = np.where(here[..., None] > 0, painted, image)
        covered = np.maximum(covered, here)
    left, upper, right, lower = (round(x * size) for x in COLLAR_SPOT)
    image[upper - 8 : lower + 8, left - 8 : right + 8] = _collar(worn, lower - upper + 16, right - left + 16)
    covered[upper - 8 : lower + 8, left - 8 : right + 8] = 1
    return np.clip(atlas.filled(image, covered), 0, 1)


def _over(under: Picture, colour: ArrayLike, share: Field) -> Picture:
    """A colour (0 to 255) laid over a picture."""
    return np.asarray(under + (np.asarray(colour) / 255 - under) * share[..., None])


def _line(field: Field, half: float = 0.0009) -> Field:
    """1 where a field (metres) is near 0."""
    return np.clip(1.5 - np.abs(field) / half, 0, 1)


def _within(field: Field, low: float, high: float, soft: float = 0.0006) -> Field:
    """1 where a field (metres) lies between two values."""
    return np.clip(0.5 + (field - low) / soft, 0, 1) * np.clip(0.5 + (high - field) / soft, 0, 1)


def _stitched(under: Picture, field: Field, where: Field, thread: ArrayLike | None = None) -> Picture:
    """A seam along the zeros of a field: a dark fold with a lighter edge, and a row of stitches beside it."""
    made = under * (1 - 0.24 * (_line(field, 0.0009) * where)[..., None])
    made = made * (1 + 0.06 * (_line(field - 0.0022, 0.0012) * where)[..., None])
    return made if thread is None else _over(made, thread, 0.55 * _line(field - 0.0045, 0.0006) * where)


def _dotted(under: Picture, x: Field, y: Field, radius: float, colour: ArrayLike) -> Picture:
    """A button, whose middle is where both fields are 0."""
    far = np.hypot(x, y)
    made = under * (1 - 0.35 * np.clip((radius * 1.35 - far) / (0.5 * radius), 0, 1))[..., None]
    made = _over(made, colour, np.clip((radius - far) / 0.0008, 0, 1))
    return made * (1 - 0.25 * np.clip((0.3 * radius - far) / 0.0006, 0, 1))[..., None]


def _top(cloth: Cloth) -> Picture:
    """Jumper, shirt or jacket, by the person's cut."""
    body, points, across = cloth.body, cloth.points, cloth.across
    worn, cut, own = cloth.worn, body.person.cut, CUTS[body.person.cut]
    on_arm = np.clip((cloth.arm - 0.5) * 8, 0, 1)
    trunk = 1 - on_arm
    shape = points.shape[:2]
    flat = points.reshape(-1, 3)
    depth, beside = (f(flat, body).reshape(shape) for f in (neckline, opening))
    along = cloth.along_arm()
    to_wrist = cloth.of_arm() - along
    y, front = points[..., 1], np.clip((points[..., 2] - 0.02) / 0.02, 0, 1)
    second, cuff = worn.second, worn.collar or worn.top
    clear = np.clip((depth - 0.05) / 0.001, 0, 1) * (to_wrist > own.cuff + 0.045) if cut == "jumper" else 1.0
    picture = _patterned(np.ones((*shape, 3)) * np.array(worn.top) / 255, cloth, clear)
    if cut == "jumper":
        ribs = 0.5 + 0.5 * np.cos(np.arctan2(points[..., 0], points[..., 2]) * 130)
        border = np.maximum(_within(depth, -1, BAND), on_arm * _within(to_wrist, -1, own.cuff + 0.04))
        picture = picture * (1 - 0.10 * border * ribs)[..., None]
        picture = _over(picture, second, _within(depth, 0.0, 0.006) + on_arm * _within(to_wrist, -1, own.cuff + 0.008))
        picture = _stitched(picture, depth - BAND, trunk)
        picture = _stitched(picture, to_wrist - own.cuff - 0.04, on_arm)
    if cut == "shirt":
        thread = np.array(worn.top) * 0.82
        for edge in (-0.016, 0.016):
            picture = _stitched(picture, np.sign(edge) * (points[..., 0] - edge), front * trunk, thread)
        for row in range(7):
            picture = _dotted(
                picture, points[..., 0] + 10 * (1 - front * trunk), y - 1.335 + 0.060 * row, 0.0052, second
            )
        beside = np.abs(points[..., 0] - 0.072) - 0.038
        pocket = np.maximum(beside, np.abs(y - 1.226) - 0.046)
        picture = _stitched(picture, -pocket, front * trunk, thread)
        picture = _stitched(picture, -np.maximum(beside, np.abs(y - 1.260) - 0.012),
                            front * trunk * (pocket < 0.001), thread)  # fmt: skip
        picture = _over(picture, cuff, (worn.pattern == "plain") * on_arm * _within(to_wrist, -1, own.cuff + 0.058))
        picture = _stitched(picture, to_wrist - own.cuff - 0.058, on_arm, thread)
        picture = _stitched(picture, own.cuff + 0.006 - to_wrist, on_arm, thread)
    if cut == "jacket":
        inner = np.ones((*shape, 3)) * np.array(second) / 255
        inner = _stitched(inner, depth - 0.018, front)
        open_front = np.clip(0.5 - beside / 0.0008, 0, 1) * trunk
        picture = _stitched(picture, depth - BAND, trunk * (beside > 0))
        picture = _stitched(picture, beside - BAND, trunk * front)
        picture = _stitched(picture, y - HEM - 0.034, trunk)
        picture = _stitched(picture, to_wrist - own.cuff - 0.040, on_arm)
        pocket = np.maximum(np.abs(across - 0.105) - 0.034, np.abs(y - 1.115) - 0.034)
        picture = _stitched(picture, -pocket, front * trunk)
        for row in range(4):
            side = (
                points[..., 0] - np.interp(1.29 - 0.068 * row, [HEM, HEM + 0.12, 1.33], [0.050, 0.047, 0.062]) - 0.011
            )
            picture = _dotted(picture, side + 10 * (1 - front * trunk), y - 1.29 + 0.068 * row, 0.0062, (92, 60, 36))
        picture = picture * (1 - 0.45 * np.clip(1 - np.abs(beside) / 0.004, 0, 1) * trunk * (beside < 0.001))[..., None]
        picture = (
            picture
            + (inner * (1 - 0.35 * np.clip(1 + beside / 0.012, 0, 1))[..., None] - picture) * open_front[..., None]
        )
        trunk = trunk * (beside > 0)
    shoulder = body.joint("leftUpperArm")
    picture = _stitched(picture, across - shoulder[0] - 0.002, y > shoulder[1] - 0.085)
    picture = _stitched(picture, points[..., 2] + 0.012, trunk * (across > 0.07) * (y < shoulder[1] - 0.06))
    return picture * (1 + 0.012 * atlas.noise(points, 0.0016, 51))[..., None]


def _patterned(under: Picture, cloth: Cloth, where: Field | float) -> Picture:
    """What is knitted, woven or printed on the top, in its second colour."""
    second, on_arm, y = cloth.worn.second, cloth.arm > 0.5, cloth.points[..., 1]
    u, v = cloth.flat()
    if cloth.worn.pattern == "stripes":
        level = np.where(on_arm, v - 0.02, HEM + 8 * STRIPE - y)
        return _over(
            under, second, _within(level % STRIPE, 0.010, 0.021) * np.clip((level + 0.001) / 0.001, 0, 1) * where
        )
    if cloth.worn.pattern == "block":  # a broad band round chest and upper arms
        level = np.where(on_arm, v, 1.315 - y)
        band = _within(level, 0.035, 0.125, 0.0008) + 0.9 * _line(level - 0.140, 0.0024)
        return _over(under, second, np.clip(band, 0, 1) * where)
    if cloth.worn.pattern == "check":
        made = under
        for at in (u, v):
            made = _over(made, second, 0.55 * _within(at % CHECK, 0.0, 0.4 * CHECK, 0.0012) * where)
            made = _over(made, (236, 226, 206), 0.40 * _line(at % CHECK - 0.7 * CHECK, 0.0010) * where)
        return made
    if cloth.worn.pattern == "dots":
        row = np.floor(v / DOT)
        far = np.hypot((u / DOT + 0.5 * (row % 2)) % 1 - 0.5, (v / DOT) % 1 - 0.5) * DOT
        return _over(under, second, 0.8 * np.clip((0.0022 - far) / 0.0007, 0, 1) * where)
    return under


def _trousers(cloth: Cloth) -> Picture:
    """Trousers with pockets, fly, side seams, and a belt."""
    body, points, across = cloth.body, cloth.points, cloth.across
    worn, y = cloth.worn, points[..., 1]
    hip, knee, ankle = (body.joint(f"left{name}") for name in ("UpperLeg", "LowerLeg", "Foot"))
    axis = [np.interp(y, [ankle[1], knee[1], hip[1]], [ankle[i], knee[i], hip[i]]) for i in (0, 2)]
    behind = points[..., 2] - axis[1] + 0.005
    front, back = np.clip(behind / 0.02, 0, 1), np.clip(-behind / 0.02, 0, 1)
    picture = np.ones((*y.shape, 3)) * np.array(worn.trousers) / 255
    thread = worn.thread
    if worn.denim:  # worn where thighs and knees rub
        rubbed = np.exp(-(((across - axis[0]) / 0.045) ** 2)) * (0.35 + 0.65 * front)
        rubbed = rubbed * (np.exp(-(((y - 0.72) / 0.16) ** 2)) + 0.5 * np.exp(-(((y - 0.49) / 0.07) ** 2)))
        picture = picture + rubbed[..., None] * np.array([0.11, 0.115, 0.115])
        picture = picture * (1 + 0.05 * atlas.noise(points * [1, 0.35, 1], 0.003, 52))[..., None]
    else:
        picture = picture * (1 + 0.08 * _line(across - axis[0], 0.002) * front * (y < 0.8))[..., None]
    picture = _stitched(picture, behind, (across > axis[0]) * (y < BELT[0] - 0.004), thread)
    picture = _stitched(picture, behind, (across < axis[0]) * (y < 0.80) * 1.0)
    slant = (across - 0.088) * 0.86 - (BELT[0] - y) * 0.51
    picture = _stitched(picture, slant, front * _within(y, BELT[0] - 0.125, BELT[0] - 0.003), thread)
    fly = np.maximum(points[..., 0] - 0.028, 0.93 + 0.35 * np.clip(0.028 - points[..., 0], 0, 1) - y)
    picture = _stitched(picture, -fly, front * (points[..., 0] > 0.001) * (y > 0.90), thread)
    picture = _stitched(picture, points[..., 0], np.maximum(front, back) * (y > 0.84) * (y < BELT[0]))
    pocket = np.maximum(
        np.abs(across - 0.088) - 0.047, np.maximum(y - 0.955, 0.835 + 0.35 * np.abs(across - 0.088) - y)
    )
    picture = _stitched(picture, -pocket, back, thread)
    for edge in (0.085, 0.079):
        picture = _over(picture, thread, 0.35 * _line(y - edge - 0.012, 0.0007))
    belted = _within(y, *BELT)
    picture = picture * (1 - 0.35 * np.clip(1 - np.abs(y - BELT[0]) / 0.005, 0, 1) * (y < BELT[0]))[..., None]
    picture = _over(picture, worn.belt, belted)
    for edge in BELT:
        picture = _over(picture, np.array(worn.belt) * 0.6, 0.8 * _line(y - edge, 0.0013))
        picture = _over(
            picture, np.array(worn.belt) * 1.45, 0.5 * _line(np.abs(y - sum(BELT) / 2) - 0.0135, 0.0007) * belted
        )
    for place in (0.062, 0.104):
        loop = _within(across, place - 0.005, place + 0.005) * _within(y, BELT[0] - 0.006, BELT[1] + 0.004)
        picture = _over(picture, np.array(worn.trousers) * 0.86, loop)
    middle = (BELT[0] + BELT[1]) / 2
    frame = np.maximum(np.abs(points[..., 0]) - 0.023, np.abs(y - middle) - 0.019)
    picture = _over(picture, (196, 178, 132), _within(frame, -0.0062, 0.0) * front)
    picture = _over(picture, (236, 226, 190), _within(frame, -0.0050, -0.0030) * front * (y > middle))
    return np.asarray(picture)


def _shoe(cloth: Cloth) -> Picture:
    """Trainers: a toe cap, laces, and a heel in the second colour."""
    body, points, across = cloth.body, cloth.points, cloth.across
    worn = cloth.worn
    ankle, toes = body.joint("leftFoot"), body.joint("leftToes")
    ahead = (points[..., 2] - ankle[2]) / (toes[2] - ankle[2])  # 0 below the ankle, 1 at the toes' joint
    line = ankle[0] + (toes[0] - ankle[0]) * ahead
    side, height = across - line, points[..., 1] - body.joint("leftFoot")[1] + 0.085
    picture = np.ones((*ahead.shape, 3)) * np.array(worn.shoes) / 255
    picture = picture * (1 + 0.01 * atlas.noise(points, 0.002, 53))[..., None]
    picture = _stitched(picture, (ahead - 0.98) * 0.13 + 2.2 * side**2, height < 9, worn.thread if worn.denim else None)
    picture = _over(picture, worn.shoe_second, _within(-ahead, 0.16, 9, 0.02) * (height > 0.03) * 0.95)
    tongue = _within(np.abs(side), -1, 0.017) * _within(ahead, 0.22, 0.86, 0.01) * (height > 0.045)
    picture = _over(picture, np.array(worn.shoes) * 0.80, tongue)
    for row in range(5):
        place = 0.30 + 0.115 * row
        lace = _within(np.abs(side), -1, 0.020) * _line((ahead - place) * 0.13 + 0.25 * np.abs(side), 0.0022)
        picture = _over(picture, worn.laces, lace * (height > 0.045))
    return picture


def _collar(worn: Outfit, high: int, wide: int) -> Picture:
    """The collar's cloth, with a seam along its edge."""
    down = np.linspace(-0.08, 1.08, high)[:, None] * np.ones((1, wide))
    across = np.abs(np.linspace(-1.08, 1.08, wide))[None, :] * np.ones((high, 1))
    picture = np.ones((high, wide, 3)) * np.array(worn.collar or worn.top) / 255
    picture = picture * (1 - 0.28 * np.exp(-(((down - 0.95) / 0.010) ** 2)))[..., None]
    picture = picture * (1 - 0.28 * np.exp(-(((across - 0.975) / 0.008) ** 2)) * (down > 0.4))[..., None]
    return gaussian_filter(picture, (0.5, 0.5, 0))


PAINTERS: dict[str, Callable[[Cloth], Picture]] = {"cloth": _top, "trousers": _trousers, "shoe": _shoe}
