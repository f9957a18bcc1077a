"""The character's head as signed distances: skull, face, nose, ears, with eyes and mouth set in.

Modelled with the mouth open (see `figure_mouth`), symmetric about x = 0. Rest pose of `HUMANOID`, metres, face
towards +Z.
"""

import numpy as np

from . import figure_eyes as eyes
from . import figure_mouth as mouth
from .figure_eyes import EYE, EYE_RADIUS, LID
from .sdf import Distances, Points, carve, ellipsoid, mirrored, rounded_cone, smooth_min, sphere, tube


def head_skin(p: Points) -> Distances:
    """Neck, skull, face, ears and lids, the mouth open with its inside."""
    q = mirrored(p)
    d = carve(neutral_skin(mouth.closed(q)), mouth.opening(q), 0.0016)
    return carve(d, eyes.lid_opening(q), 0.0016)


def neutral_skin(q: Points) -> Distances:
    """The same with closed lips and no openings; for points of the left half (x >= 0)."""
    face = ground(q)
    d = smooth_min(face, _neck(q), 0.030)
    d = smooth_min(d, _nose(q), 0.010)
    d = carve(d, ellipsoid(q, (0.0072, 1.5432, 0.0945), (0.0030, 0.0026, 0.0052)), 0.003)
    d = mouth.lips(d, face, q)
    d = smooth_min(d, _ear(q), 0.007)
    return smooth_min(d, sphere(q, EYE, EYE_RADIUS + LID), 0.006)


def ground(q: Points) -> Distances:
    """Skull, jaw, cheeks, brow ridge and eye sockets: the ground on which brows and lips are draped."""
    d = ellipsoid(q, (0, 1.612, -0.010), (0.0755, 0.082, 0.092))
    d = smooth_min(d, ellipsoid(q, (0, 1.556, 0.022), (0.0620, 0.066, 0.066)), 0.045)
    d = smooth_min(d, _jaw(q), 0.035)
    d = smooth_min(d, sphere(q, (0.036, 1.550, 0.055), 0.0245), 0.025)
    d = smooth_min(d, rounded_cone(q, (0.010, 1.609, 0.0755), (0.044, 1.611, 0.058), 0.010, 0.009), 0.022)
    d = carve(d, ellipsoid(q, EYE + (0.000, 0.001, 0.034), (0.026, 0.0165, 0.0200)), 0.018)
    return smooth_min(d, ellipsoid(q, (0, 1.5215, 0.0640), (0.0310, 0.0250, 0.0220)), 0.020)


def brow(p: Points) -> Distances:
    """Both eyebrows."""
    return eyes.brow(p, ground(mirrored(p)))


def _jaw(q: Points) -> Distances:
    d = rounded_cone(q, (0.048, 1.540, 0.006), (0.0115, 1.4935, 0.0660), 0.0165, 0.0150)
    return smooth_min(d, sphere(q, (0, 1.4925, 0.0700), 0.0150), 0.020)


def _neck(q: Points) -> Distances:
    d = rounded_cone(q, (0, 1.395, -0.030), (0, 1.520, -0.018), 0.0535, 0.0490)
    return smooth_min(d, rounded_cone(q, (0, 1.415, -0.030), (0.115, 1.395, -0.028), 0.045, 0.030), 0.05)


def _nose(q: Points) -> Distances:
    bridge = [(0, 1.596, 0.0800, 0.0068), (0, 1.572, 0.0895, 0.0076), (0, 1.5545, 0.0975, 0.0106)]
    return smooth_min(tube(q, bridge, 0.012), ellipsoid(q, (0.0105, 1.5505, 0.0870), (0.0074, 0.0070, 0.0092)), 0.009)


def _ear(q: Points) -> Distances:
    turn, lean = np.radians(24.0), np.radians(10.0)
    out = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    up = np.array([0.0, np.cos(lean), -np.sin(lean)])
    axes = np.stack([out, up, np.cross(out, up)])
    d = ellipsoid(q, (0.0765, 1.572, -0.014), (0.0078, 0.0270, 0.0170), axes)
    d = smooth_min(d, sphere(q, (0.0750, 1.548, -0.006), 0.0070), 0.008)
    return carve(d, ellipsoid(q, (0.0865, 1.5745, -0.0125), (0.0075, 0.0165, 0.0098), axes), 0.005)
