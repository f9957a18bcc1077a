"""The character's eyes: eyeballs, the almond between the lids, lashes and brows (metres, rest pose)."""

import numpy as np

from .sculpt import Mesh, outward
from .sdf import Distances, Points, common, curve, draped, mirrored, tube

EYE = np.array([0.0330, 1.5865, 0.0615])  # centre of the left eyeball
EYE_RADIUS = 0.0172
LID = 0.0024  # thickness of the lids
LID_WIDTH = 0.0150  # half width of the opening between the lids
LASH = (34, 24, 22)
EYE_WHITE, IRIS, IRIS_RIM, PUPIL = (246, 244, 240), (122, 78, 42), (62, 38, 22), (14, 11, 10)


def upper_rim(x: Distances) -> Distances:
    """Height of the upper lid's edge above the eye's centre; `x` outwards from the centre in LID_WIDTH."""
    height: Distances = 0.0074 * _arch(x) * (1 + 0.12 * x) + _lean(x)
    return height


def lower_rim(x: Distances) -> Distances:
    """Height of the lower lid's edge."""
    height: Distances = -0.0066 * _arch(x) + _lean(x)
    return height


def lid_opening(q: Points) -> Distances:
    """The almond between the lids as a prism along Z, in front of the eye's centre (left half)."""
    local = q - EYE
    x = local[:, 0] / LID_WIDTH
    upper, lower = local[:, 1] - upper_rim(x), lower_rim(x) - local[:, 1]
    return common(upper, lower, -local[:, 2])


def brow(p: Points, ground: Distances) -> Distances:
    """Both eyebrows: tapered strokes that lie on the brow ridge, `ground` being the distance to it."""
    q = mirrored(p)
    path = [
        (0.0140, 1.6090, 0.0000, 0.0024),
        (0.0230, 1.6128, 0.0004, 0.0031),
        (0.0350, 1.6150, 0.0004, 0.0028),
        (0.0480, 1.6105, -0.0002, 0.0011),
    ]
    stroke = tube(draped(q, ground), curve(path, 14), 0.002)
    return common(stroke, 0.02 - q[:, 2])


def lashes(side: float) -> Mesh:
    """The dark line along one upper lid, thicker towards the outer corner: a tube that is pointed at both ends."""
    x = np.linspace(-0.99, 1.03, 30)
    y = upper_rim(x)
    rim = EYE_RADIUS + LID - 0.0002
    z = np.sqrt(np.maximum(rim**2 - (x * LID_WIDTH) ** 2 - y**2, 0))
    radius = np.interp(x, [-0.99, -0.8, 0.3, 0.85, 1.03], [0.0001, 0.0005, 0.0010, 0.0012, 0.0002])
    middle = np.stack([x * LID_WIDTH, y + 0.0004, z], 1)
    along = np.gradient(middle, axis=0)
    outwards = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    upwards = np.cross(outwards, along)
    upwards /= np.linalg.norm(upwards, axis=1, keepdims=True)
    turn = np.arange(8) * np.pi / 4
    normals = np.cos(turn)[:, None] * outwards[:, None] + np.sin(turn)[:, None] * upwards[:, None]
    points = EYE + middle[:, None] + radius[:, None, None] * normals
    ring, spoke = np.meshgrid(np.arange(len(x) - 1), np.arange(8), indexing="ij")
    a, b = ring * 8 + spoke, ring * 8 + (spoke + 1) % 8
    quads = np.stack([a, b, b + 8, a + 8], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    flat, out = points.reshape(-1, 3) * [side, 1, 1], normals.reshape(-1, 3) * [side, 1, 1]
    return Mesh(flat.astype(np.float32), out.astype(np.float32), outward(flat, out, faces))


def eyeball(side: float) -> tuple[Mesh, np.ndarray]:
    """One eyeball with its colours; rings about the line of sight, so that iris and pupil have clean edges."""
    rings = np.radians([0, 7, 12, 13.5, 21, 28.5, 31.5, 33.5, 44, 58, 78, 102])
    shades = [PUPIL] * 3 + [IRIS_RIM] + [IRIS] * 2 + [IRIS_RIM] + [EYE_WHITE] * 5
    spokes = 28
    turn = np.arange(spokes) * 2 * np.pi / spokes
    across = np.sin(rings)[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)[:, None]
    ahead = np.tile(np.cos(rings)[:, None], spokes)[..., None]
    normals = np.concatenate([across.transpose(1, 0, 2), ahead], -1).reshape(-1, 3)
    ring, spoke = np.meshgrid(np.arange(len(rings) - 1), np.arange(spokes), indexing="ij")
    a, b = ring * spokes + spoke, ring * spokes + (spoke + 1) % spokes
    inner, outer = np.stack([a, a + spokes, b + spokes], -1), np.stack([a, b + spokes, b], -1)
    faces = np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)[spokes:]])  # the first ring is a point
    points = EYE * (side, 1, 1) + normals * EYE_RADIUS
    colours = np.repeat(np.asarray(shades, np.float64), spokes, axis=0)
    return Mesh(points.astype(np.float32), normals.astype(np.float32), faces.astype(np.int32)), colours


def _arch(x: Distances) -> Distances:
    arch: Distances = 1 - np.clip(np.abs(x), 0, 1.3) ** 2
    return arch


def _lean(x: Distances) -> Distances:
    """The outer corner is a little higher."""
    lean: Distances = 0.0012 * x
    return lean
