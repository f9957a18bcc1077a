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
    ellipsoid,
    mirrored,
    rounded_cone,
    smooth_max,
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

    lid_upper: float = 0.0076  # height of the upper lid above the eye's centre line, at its middle
    lid_lower: float = 0.0072  # depth of the lower lid below it
    brow_raise: float = 0.0
    brow_tilt: float = 0.0  # inner ends up
    jaw_drop: float = 0.0
    mouth_wide: float = 0.0  # corners outwards
    mouth_smile: float = 0.0018  # corners upwards
    mouth_pucker: float = 0.0  # lips forwards


NEUTRAL = FaceShape()


def head_skin(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Neck, skull, face, ears and lids, with the openings for the eyes."""
    q = mirrored(p)
    d = ellipsoid(q, (0, 1.612, -0.010), (0.0755, 0.082, 0.092))
    d = smooth_min(d, ellipsoid(q, (0, 1.556, 0.022), (0.0635, 0.066, 0.066)), 0.045)
    d = smooth_min(d, _jaw(q, face), 0.035)
    d = smooth_min(d, sphere(q, (0.036, 1.550, 0.055), 0.0245), 0.025)
    d = smooth_min(d, rounded_cone(q, (0.010, 1.609, 0.0755), (0.044, 1.611, 0.058), 0.010, 0.009), 0.022)
    d = carve(d, ellipsoid(q, EYE + (0.000, 0.001, 0.034), (0.026, 0.0165, 0.0200)), 0.018)
    d = smooth_min(d, _neck(q), 0.030)
    d = smooth_min(d, _nose(q), 0.010)
    d = carve(d, ellipsoid(q, (0.0060, 1.5455, 0.0935), (0.0030, 0.0028, 0.0045)), 0.003)
    d = _mouth(d, q, face)
    d = smooth_min(d, _ear(q), 0.007)
    d = smooth_min(d, sphere(q, EYE, EYE_RADIUS + 0.0022), 0.006)
    return carve(d, lid_opening(q, face), 0.0016)


def lid_opening(q: Points, face: FaceShape = NEUTRAL) -> Distances:
    """The almond between the lids as a prism along Z, in front of the eye's centre (left half)."""
    local = q - EYE
    x = local[:, 0] / LID_WIDTH
    arch = 1 - np.clip(np.abs(x), 0, 1.3) ** 2
    lean = 0.0012 * x  # outer corner a little higher
    upper = np.asarray(local[:, 1] - (face.lid_upper * arch * (1 + 0.12 * x) + lean))
    lower = np.asarray(-face.lid_lower * arch + lean - local[:, 1])
    d: Distances = np.maximum(np.maximum(upper, lower), -local[:, 2])
    return d


def lip_mask(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Negative on the lips: where the skin takes the lips' colour."""
    q = mirrored(p)
    upper, lower = _lips(q, face)
    edge = 1 - np.clip(q[:, 0] / (0.0235 + face.mouth_wide), 0, 1.2) ** 2
    middle = 1.5205 + face.mouth_smile * (1 - edge)
    bow = 0.0012 * np.exp(-((q[:, 0] / 0.004) ** 2))
    above = q[:, 1] - (middle + 0.0072 * edge - bow)
    below = middle - 0.0082 * edge - q[:, 1]
    return np.maximum(np.maximum(np.maximum(above, below), 0.070 - q[:, 2]), np.minimum(upper, lower) - 0.004)


def brow(p: Points, face: FaceShape = NEUTRAL) -> Distances:
    """Both eyebrows: tapered strokes that lie on the brow ridge."""
    q = mirrored(p)
    up, tilt = face.brow_raise, face.brow_tilt
    path = [
        (0.0135, 1.6085 + up + tilt, 0.0880, 0.0030),
        (0.0240, 1.6125 + up, 0.0860, 0.0034),
        (0.0360, 1.6140 + up, 0.0790, 0.0030),
        (0.0475, 1.6095 + up - tilt, 0.0660, 0.0016),
    ]
    return tube(q, path, 0.006)


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


def hair(p: Points) -> Distances:
    """A short side-swept cut: cropped sides and nape, a full top, sculpted strands."""
    d = ellipsoid(p, (0, 1.618, -0.013), (0.0845, 0.088, 0.100))
    nape = rounded_cone(p, (0, 1.560, -0.066), (0, 1.515, -0.060), 0.042, 0.026)
    d = smooth_min(d, nape, 0.03)
    d = carve(d, ellipsoid(p, (0, 1.545, 0.088), (0.0735, 0.088, 0.088)), 0.010)
    q = mirrored(p)
    d = carve(d, ellipsoid(q, (0.078, 1.555, 0.006), (0.030, 0.040, 0.026)), 0.012)
    below = q[:, 1] - (1.500 + 0.35 * np.maximum(q[:, 0] - 0.02, 0) + 0.25 * np.maximum(q[:, 2] + 0.06, 0))
    d = smooth_max(d, -below, 0.010)
    for path in LOCKS:
        d = smooth_min(d, tube(p, path, 0.012), 0.012)
    return d + _strands(p)


LOCKS = (
    # swept from the parting on the character's left across to its right, front to crown; rows x, y, z, radius
    [(0.034, 1.682, 0.052, 0.012), (0.008, 1.696, 0.068, 0.018), (-0.030, 1.684, 0.070, 0.017), (-0.062, 1.655, 0.052, 0.008)],
    [(0.036, 1.680, 0.050, 0.011), (0.018, 1.683, 0.077, 0.016), (-0.014, 1.675, 0.086, 0.016), (-0.048, 1.652, 0.074, 0.010), (-0.062, 1.634, 0.060, 0.004)],
    [(0.030, 1.692, 0.030, 0.012), (-0.005, 1.708, 0.040, 0.019), (-0.045, 1.692, 0.036, 0.018), (-0.074, 1.655, 0.026, 0.008)],
    [(0.026, 1.698, 0.000, 0.012), (-0.010, 1.710, 0.008, 0.019), (-0.050, 1.692, 0.004, 0.018), (-0.078, 1.650, 0.000, 0.008)],
    [(0.038, 1.680, 0.048, 0.010), (0.055, 1.664, 0.050, 0.012), (0.068, 1.642, 0.040, 0.010), (0.073, 1.618, 0.032, 0.004)],
    [(0.036, 1.686, 0.020, 0.012), (0.060, 1.672, 0.016, 0.014), (0.078, 1.640, 0.010, 0.008)],
    [(0.015, 1.702, -0.030, 0.014), (-0.020, 1.704, -0.040, 0.020), (-0.055, 1.680, -0.045, 0.014)],
    [(0.030, 1.694, -0.030, 0.014), (0.058, 1.672, -0.040, 0.016), (0.076, 1.640, -0.045, 0.008)],
)  # fmt: skip


def _strands(p: Points) -> Distances:
    """Shallow grooves that run from the parting over the top and down the back."""
    angle = np.arctan2(p[:, 0] - 0.030, p[:, 2] + 0.030) + 3.0 * (p[:, 1] - 1.64)
    reach = np.clip(np.hypot(p[:, 0] - 0.030, p[:, 2] + 0.030) / 0.05, 0, 1)
    strands: Distances = (0.0011 * reach * (np.sin(21 * angle) + 0.5 * np.sin(34 * angle + 1.0))).astype(p.dtype)
    return strands


def _jaw(q: Points, face: FaceShape) -> Distances:
    drop = face.jaw_drop
    chin = (0.0115, 1.4935 - drop, 0.0660 - 0.4 * drop)
    d = rounded_cone(q, (0.048, 1.540, 0.006), chin, 0.0165, 0.0150)
    return smooth_min(d, sphere(q, (0, 1.4925 - drop, 0.0700 - 0.4 * drop), 0.0150), 0.020)


def _neck(q: Points) -> Distances:
    d = rounded_cone(q, (0, 1.395, -0.030), (0, 1.520, -0.018), 0.0535, 0.0490)
    return smooth_min(d, rounded_cone(q, (0, 1.415, -0.030), (0.115, 1.395, -0.028), 0.045, 0.030), 0.05)


def _nose(q: Points) -> Distances:
    d = tube(q, [(0, 1.594, 0.0805, 0.0070), (0, 1.570, 0.0905, 0.0078), (0, 1.5535, 0.0985, 0.0098)], 0.012)
    return smooth_min(d, ellipsoid(q, (0.0098, 1.5505, 0.0875), (0.0070, 0.0068, 0.0090)), 0.008)


def _lips(q: Points, face: FaceShape) -> tuple[Distances, Distances]:
    wide, up, out = face.mouth_wide, face.mouth_smile, face.mouth_pucker
    corner = (0.0215 + wide, 1.5205 + up, 0.0745)
    upper_path = [(0, 1.5247, 0.0905 + out, 0.0040), (0.0055, 1.5252, 0.0903 + out, 0.0042), (0.0135, 1.5235 + up / 3, 0.0855 + out / 2, 0.0036), (*corner, 0.0020)]  # fmt: skip
    drop = face.jaw_drop
    lower_path = [(0, 1.5155 - drop, 0.0885 + out, 0.0056), (0.0100, 1.5165 - 0.8 * drop + up / 4, 0.0860 + out, 0.0050), (*corner, 0.0020)]  # fmt: skip
    return tube(q, upper_path, 0.004), tube(q, lower_path, 0.006)


def _mouth(d: Distances, q: Points, face: FaceShape) -> Distances:
    d = smooth_min(d, ellipsoid(q, (0, 1.5225, 0.0660), (0.0275, 0.0240, 0.0200)), 0.018)
    upper, lower = _lips(q, face)
    d = smooth_min(d, upper, 0.005)
    d = smooth_min(d, lower, 0.006)
    up = face.mouth_smile
    line = [(0, 1.5207, 0.0945, 0.0012), (0.0110, 1.5203 + up / 4, 0.0905, 0.0011), (0.0205 + face.mouth_wide, 1.5205 + up, 0.0775, 0.0013), (0.0240 + face.mouth_wide, 1.5215 + 1.2 * up, 0.0735, 0.0006)]  # fmt: skip
    d = carve(d, tube(q, line, 0.002), 0.0028)
    return carve(d, rounded_cone(q, (0, 1.5400, 0.0945), (0, 1.5320, 0.0945), 0.0030, 0.0035), 0.008)


def _ear(q: Points) -> Distances:
    turn, lean = np.radians(24.0), np.radians(10.0)
    out = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    up = np.array([0.0, np.cos(lean), -np.sin(lean)])
    axes = np.stack([out, up, np.cross(out, up)])
    d = ellipsoid(q, (0.0775, 1.572, -0.014), (0.0085, 0.0300, 0.0185), axes)
    d = smooth_min(d, sphere(q, (0.0750, 1.548, -0.006), 0.0070), 0.008)
    return carve(d, ellipsoid(q, (0.0880, 1.574, -0.0125), (0.0080, 0.0190, 0.0105), axes), 0.005)
