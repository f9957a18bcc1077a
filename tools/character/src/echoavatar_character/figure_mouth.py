"""The character's mouth as signed distances: lips, the cut between them, the cavity, teeth and tongue.

The mouth is modelled open, so that the mesh has an upper lip, a lower lip and an inside. `closed` then moves every
point to its place in the neutral face, where the lips meet. Face shapes start from there; `above` tells to which lip a
point belongs. Metres, rest pose of `HUMANOID`, face towards +Z.
"""

import numpy as np
from jaxtyping import Float

from .sdf import Distances, Points, common, curve, draped, rise, rounded_cone, smooth_min, tube

WIDE = 0.0235  # from the middle to a corner
HEIGHT = 1.5195  # of the line between the lips, in the middle
LIFT = 0.0030  # how much higher the corners are
GAP = 0.0036  # half the opening of the modelled mouth
REACH = 0.016  # how far above and below the lips the opening is felt
ARCH = 9.0  # the rows of teeth and the lips bend back by ARCH x^2
TEETH = 0.0800  # depth (z) of the front of the upper teeth, in the middle

Labels = Float[np.ndarray, " n"]


def line(x: Distances) -> Distances:
    """Height of the line between the closed lips."""
    height: Distances = HEIGHT + LIFT * np.clip(np.abs(x) / WIDE, 0, 1.2) ** 2
    return height


def above(p: Points) -> Labels:
    """+1 for modelled points of the upper lip and all above, -1 for those of the lower lip and all below."""
    return np.where(p[:, 1] >= line(p[:, 0]), 1.0, -1.0)


def closed(p: Points, side: Labels | None = None) -> Points:
    """Move modelled points to the neutral face: the edges of the cut meet on `line`."""
    side = above(p) if side is None else side
    away = side * (p[:, 1] - line(p[:, 0]))
    half = np.maximum(_gap(p[:, 0]), 0) * rise(p[:, 2], 0.0, 0.04)
    felt = 1 - rise(away, half, REACH)
    neutral = p.copy()
    neutral[:, 1] = p[:, 1] - side * half * felt
    return neutral


def lips(solid: Distances, face: Distances, p: Points) -> Distances:
    """Lips laid on the neutral `solid` as strokes draped over `face`, the dent above them and the one below."""
    flat = draped(p, face)
    flat[:, 2] = np.where(p[:, 2] > 0.03, flat[:, 2], 1.0)  # the front only
    upper = [
        (-0.0030, 1.5232, -0.0004, 0.0038),
        (0.0046, 1.5240, 0.0000, 0.0041),
        (0.0130, 1.5230, -0.0006, 0.0036),
        (WIDE + 0.0005, 1.5216, -0.0030, 0.0013),
    ]
    lower = [
        (-0.0030, 1.5143, 0.0002, 0.0052),
        (0.0070, 1.5147, 0.0000, 0.0050),
        (0.0150, 1.5172, -0.0010, 0.0038),
        (WIDE + 0.0005, 1.5208, -0.0030, 0.0013),
    ]
    d = smooth_min(solid, tube(flat, curve(upper, 10), 0.004), 0.005)
    d = smooth_min(d, tube(flat, curve(lower, 10), 0.004), 0.006)
    dent = rounded_cone(p, (0, 1.5385, 0.0965), (0, 1.5315, 0.0965), 0.0022, 0.0032)
    return -smooth_min(-d, dent, 0.006)


def opening(p: Points) -> Distances:
    """The air in the modelled mouth: the cut between the lips and the cavity behind the teeth."""
    straight = p.copy()
    straight[:, 2] = p[:, 2] + ARCH * p[:, 0] ** 2
    cut = common(np.abs(p[:, 1] - line(p[:, 0])) - _gap(p[:, 0]), 0.060 - p[:, 2])
    middle, half = np.array([0.0, 1.5185, 0.052]), np.array([0.0245, 0.0185, 0.0305])
    return smooth_min(cut, _box(straight, middle, half, 0.010), 0.002)


def lip_mask(p: Points) -> Distances:
    """Negative on the lips of the neutral face: where the skin takes the lips' colour."""
    x = np.abs(p[:, 0])
    edge = np.clip(1 - (x / (WIDE + 0.0012)) ** 2, -0.5, 1)
    bow = 0.0016 * np.exp(-((x / 0.0036) ** 2)) - 0.0004 * np.exp(-(((x - 0.006) / 0.004) ** 2))
    top = line(x) + 0.0084 * np.maximum(edge, 0) ** 0.9 - bow
    bottom = line(x) - 0.0092 * np.maximum(edge, 0) ** 0.75
    outside = np.maximum(x - WIDE - 0.0012, -0.004)
    return common(p[:, 1] - top, bottom - p[:, 1], outside, 0.060 - p[:, 2])


def inside_mask(p: Points) -> Distances:
    """Negative behind the lips of the modelled mouth: where the skin becomes the wall of the mouth."""
    depth = p[:, 2] + ARCH * p[:, 0] ** 2
    return common(opening(p) - 0.0015, depth - 0.0862)


def _gap(x: Distances) -> Distances:
    """Half the modelled opening along the lips, negative beyond the corners."""
    along = np.abs(x) / WIDE
    half: Distances = GAP * np.maximum(1 - along**2, 0) ** 0.7 - 0.6 * np.maximum(np.abs(x) - WIDE, 0)
    return half


def _box(p: Points, middle: np.ndarray, half: np.ndarray, radius: float) -> Distances:
    """Distance to a box with round edges."""
    q = np.abs(p - middle.astype(p.dtype)) - (half - radius).astype(p.dtype)
    far = np.sqrt((np.maximum(q, 0) ** 2).sum(1))
    distance: Distances = far + np.minimum(q.max(1), 0) - radius
    return distance
