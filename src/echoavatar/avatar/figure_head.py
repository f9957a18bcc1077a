"""The character's head as signed distances: skin, lids, brows, lips, ears, hair and eyes.

`FaceShape` holds what an expression moves. A blend shape is made by projecting the neutral mesh onto the field of
another shape, so lids, lips and jaw stay clean surfaces. Rest pose of `HUMANOID`, metres, face towards +Z.
"""

from dataclasses import dataclass

import numpy as np

from .sdf import (
    Distances,
    Points,
    carve,
    common,
    curve,
    draped,
    ellipsoid,
    mirrored,
    rounded_cone,
    smooth_min,
    sphere,
    tube,
)

EYE = np.array([0.0330, 1.5865, 0.0615])  # centre of the left eyeball
EYE_RADIUS = 0.0172
LID_WIDTH = 0.0150  # half width of the opening between the lids


@dataclass(frozen=True)
class FaceShape:
    """What an expression moves; the defaults are the neutral face, lengths in metres."""

    lid_upper: float = 0.0074  # height of the upper lid above the eye's centre line, at its middle
    lid_lower: float = 0.0066  # depth of the lower lid below it
    brow_raise: float = 0.0
    brow_tilt: float = 0.0  # inner ends up
    jaw_drop: float = 0.0
    mouth_wide: float = 0.0  # corners outwards
    mouth_smile: float = 0.0034  # corners upwards
    mouth_pucker: float = 0.0  # lips forwards


NEUTRAL = FaceShape()


def head_skin(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Neck, skull, face, ears and lids, with the openings for the eyes."""
    q = mirrored(p)
    d = _face(q, face)
    d = smooth_min(d, _neck(q), 0.030)
    d = smooth_min(d, _nose(q), 0.010)
    d = carve(d, ellipsoid(q, (0.0062, 1.5440, 0.0930), (0.0034, 0.0030, 0.0052)), 0.005)
    d = _mouth(d, q, face)
    d = smooth_min(d, _ear(q), 0.007)
    d = smooth_min(d, sphere(q, EYE, EYE_RADIUS + 0.0022), 0.006)
    return carve(d, lid_opening(q, face), 0.0016)


def _face(q: Points, face: FaceShape) -> Distances:
    """Skull, jaw, cheeks, brow ridge and eye sockets: the ground on which brows and lips are draped."""
    d = ellipsoid(q, (0, 1.612, -0.010), (0.0755, 0.082, 0.092))
    d = smooth_min(d, ellipsoid(q, (0, 1.556, 0.022), (0.0620, 0.066, 0.066)), 0.045)
    d = smooth_min(d, _jaw(q, face), 0.035)
    d = smooth_min(d, sphere(q, (0.036, 1.550, 0.055), 0.0245), 0.025)
    d = smooth_min(d, rounded_cone(q, (0.010, 1.609, 0.0755), (0.044, 1.611, 0.058), 0.010, 0.009), 0.022)
    d = carve(d, ellipsoid(q, EYE + (0.000, 0.001, 0.034), (0.026, 0.0165, 0.0200)), 0.018)
    return smooth_min(d, ellipsoid(q, (0, 1.5215, 0.0640), (0.0310, 0.0250, 0.0220)), 0.020)


def lid_opening(q: Points, face: FaceShape = NEUTRAL) -> Distances:
    """The almond between the lids as a prism along Z, in front of the eye's centre (left half)."""
    local = q - EYE
    x = local[:, 0] / LID_WIDTH
    arch = 1 - np.clip(np.abs(x), 0, 1.3) ** 2
    lean = 0.0012 * x  # outer corner a little higher
    upper = np.asarray(local[:, 1] - (face.lid_upper * arch * (1 + 0.12 * x) + lean))
    lower = np.asarray(-face.lid_lower * arch + lean - local[:, 1])
    d: Distances = common(upper, lower, -local[:, 2])
    return d


def lip_mask(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Negative on the lips: where the skin takes the lips' colour."""
    q = mirrored(p)
    wide = 0.0258 + face.mouth_wide
    edge = np.clip(1 - (q[:, 0] / wide) ** 2, -0.5, 1)
    middle = _mouth_height(q, face)
    bow = 0.0013 * np.exp(-((q[:, 0] / 0.0045) ** 2))
    above = q[:, 1] - (middle + 0.0082 * edge - bow)
    below = middle - face.jaw_drop - 0.0094 * edge - q[:, 1]
    return common(above, below, 0.060 - q[:, 2])


def brow(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Both eyebrows: tapered strokes that lie on the brow ridge."""
    q = mirrored(p)
    up, tilt = face.brow_raise, face.brow_tilt
    path = [
        (0.0140, 1.6090 + up + tilt, 0.0000, 0.0024),
        (0.0230, 1.6128 + up + tilt / 2, 0.0004, 0.0031),
        (0.0350, 1.6150 + up, 0.0004, 0.0028),
        (0.0480, 1.6105 + up - tilt, -0.0002, 0.0011),
    ]
    stroke = tube(draped(q, _face(q, NEUTRAL)), curve(path, 14), 0.002)
    return common(stroke, 0.02 - q[:, 2])


def lashes(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """The dark line along each upper lid, thicker towards the outer corner."""
    q = mirrored(p)
    x = np.linspace(-0.98, 1.1, 8)
    y = face.lid_upper * (1 - np.clip(np.abs(x), 0, 1.3) ** 2) * (1 + 0.12 * x) + 0.0012 * x
    rim = EYE_RADIUS + 0.0019
    z = np.sqrt(np.maximum(rim**2 - (x * LID_WIDTH) ** 2 - y**2, 0))
    radius = np.interp(x, [-0.98, 0.3, 0.9, 1.1], [0.0004, 0.0011, 0.0013, 0.0005])
    rows = np.column_stack([EYE[0] + x * LID_WIDTH, EYE[1] + y + 0.0004, EYE[2] + z, radius])
    return tube(q, rows.tolist(), 0.001)


def _jaw(q: Points, face: FaceShape) -> Distances:
    drop = face.jaw_drop
    chin = (0.0115, 1.4935 - drop, 0.0660 - 0.4 * drop)
    d = rounded_cone(q, (0.048, 1.540, 0.006), chin, 0.0165, 0.0150)
    return smooth_min(d, sphere(q, (0, 1.4925 - drop, 0.0700 - 0.4 * drop), 0.0150), 0.020)


def _neck(q: Points) -> Distances:
    d = rounded_cone(q, (0, 1.395, -0.030), (0, 1.520, -0.018), 0.0535, 0.0490)
    return smooth_min(d, rounded_cone(q, (0, 1.415, -0.030), (0.115, 1.395, -0.028), 0.045, 0.030), 0.05)


def _nose(q: Points) -> Distances:
    bridge = [(0, 1.596, 0.0800, 0.0068), (0, 1.572, 0.0895, 0.0076), (0, 1.5545, 0.0975, 0.0106)]
    return smooth_min(
        tube(q, bridge, 0.012), ellipsoid(q, (0.0105, 1.5505, 0.0870), (0.0074, 0.0070, 0.0092)), 0.009
    )


def _mouth_height(q: Points, face: FaceShape) -> Distances:
    """Height of the line between the lips: level in the middle, rising to the corners."""
    height: Distances = 1.5200 + face.mouth_smile * np.clip(np.abs(q[:, 0]) / 0.0250, 0, 1.2) ** 2
    return height


def _lips(face: FaceShape) -> tuple[list[list[float]], list[list[float]], list[list[float]]]:
    """Upper lip, lower lip and the line between, as strokes draped on the face: x, y, height, radius."""
    wide, up, out, drop = 0.0245 + face.mouth_wide, face.mouth_smile, face.mouth_pucker, face.jaw_drop
    upper = [
        (-0.002, 1.5238, out, 0.0040),
        (0.0060, 1.5243, out, 0.0043),
        (0.0150, 1.5230 + up / 3, out / 2, 0.0036),
        (wide, 1.5203 + up, -0.0010, 0.0016),
    ]
    lower = [
        (-0.002, 1.5148 - drop, out, 0.0054),
        (0.0080, 1.5150 - drop, out, 0.0052),
        (0.0165, 1.5168 - 0.7 * drop + up / 3, out / 2, 0.0040),
        (wide, 1.5198 + up, -0.0010, 0.0016),
    ]
    line = [
        (-0.002, 1.5200, 0.0042, 0.0014),
        (0.0100, 1.5202 + up / 8, 0.0040, 0.0013),
        (0.0190, 1.5200 + up * 0.6, 0.0024, 0.0013),
        (wide + 0.0022, 1.5202 + up * 1.15, 0.0004, 0.0008),
    ]
    return curve(upper, 9), curve(lower, 9), curve(line, 9)  # fmt: skip


def _mouth(d: Distances, q: Points, face: FaceShape) -> Distances:
    flat = draped(q, _face(q, face))
    flat[:, 2] = np.where(q[:, 2] > 0.03, flat[:, 2], 1.0)  # the front only
    upper, lower, line = (path for path in _lips(face))
    d = smooth_min(d, tube(flat, upper, 0.004), 0.005)
    d = smooth_min(d, tube(flat, lower, 0.004), 0.006)
    d = carve(d, tube(flat, line, 0.002), 0.0032)
    return carve(d, rounded_cone(q, (0, 1.5400, 0.0955), (0, 1.5330, 0.0950), 0.0028, 0.0034), 0.008)


def _ear(q: Points) -> Distances:
    turn, lean = np.radians(24.0), np.radians(10.0)
    out = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    up = np.array([0.0, np.cos(lean), -np.sin(lean)])
    axes = np.stack([out, up, np.cross(out, up)])
    d = ellipsoid(q, (0.0765, 1.572, -0.014), (0.0078, 0.0270, 0.0170), axes)
    d = smooth_min(d, sphere(q, (0.0750, 1.548, -0.006), 0.0070), 0.008)
    return carve(d, ellipsoid(q, (0.0865, 1.5745, -0.0125), (0.0075, 0.0165, 0.0098), axes), 0.005)
