"""The character's hands as signed distances, ten separate fingers on the rest pose of `HUMANOID` (metres, T-pose)."""

import numpy as np

from echoavatar.motion.kinematics import HUMANOID

from .rigging import REST
from .sdf import Distances, Points, ellipsoid, mirrored, rounded_cone, smooth_min, tube, union


def hands(p: Points) -> Distances:
    """Both hands with ten separate fingers, and the wrists."""
    q = mirrored(p)
    at = {name[4:]: REST[i] for i, name in enumerate(HUMANOID.names) if name.startswith("left")}
    wrist = at["Hand"]
    d = _flat_cone(q, wrist + (-0.05, 0, 0.001), wrist + (0.004, 0, 0.001), 0.0270, 0.0245)
    for finger, radius in (("Index", 0.0135), ("Middle", 0.0140), ("Ring", 0.0130), ("Little", 0.0120)):
        knuckle = at[f"{finger}Proximal"]
        root = wrist + (0.012, 0.0, 0.55 * (knuckle - wrist)[2])
        d = smooth_min(d, rounded_cone(q, root, knuckle - (0.007, 0.0030, 0), 0.0165, radius - 0.002), 0.016)
    thumb = at["ThumbMetacarpal"], at["ThumbProximal"]
    d = smooth_min(d, rounded_cone(q, thumb[0] + (0.002, 0, -0.004), thumb[1], 0.0165, 0.0112), 0.022)
    d = smooth_min(
        d, rounded_cone(q, thumb[0] + (0.010, -0.002, 0), wrist + (0.070, -0.004, 0.010), 0.0130, 0.0100), 0.020
    )
    for finger, (r0, r1, r2, r3), reach in FINGERS:
        bones = [
            at[f"{finger}{bone}"]
            for bone in (
                ("Proximal", "Intermediate", "Distal") if finger != "Thumb" else ("Metacarpal", "Proximal", "Distal")
            )
        ]
        way = bones[2] - bones[1]
        tip = bones[2] + way / np.linalg.norm(way) * reach
        rows = [(*point, r) for point, r in zip([*bones, tip], (r0, r1, r2, r3), strict=True)]
        d = smooth_min(d, tube(q, rows if finger != "Thumb" else rows[1:], 0.004), 0.007)
    return d


def nail_mask(p: Points) -> Distances:
    """Negative on the finger nails: where the skin takes the nails' colour."""
    q = mirrored(p)
    at = {name[4:]: REST[i] for i, name in enumerate(HUMANOID.names) if name.startswith("left")}
    nails = []
    for finger, radii, reach in FINGERS:
        bone = at[f"{finger}Distal"]
        way = bone - at[f"{finger}Intermediate" if finger != "Thumb" else f"{finger}Proximal"]
        way = way / np.linalg.norm(way)
        up = np.array([-0.35, 0.94, 0.0]) if finger == "Thumb" else np.array([0.0, 1.0, 0.0])
        up = up - (up @ way) * way
        axes = np.stack([way, up / np.linalg.norm(up), np.cross(way, up / np.linalg.norm(up))])
        r = radii[3]
        nails.append(ellipsoid(q, bone + way * (reach + 0.0005) + axes[1] * r, (0.0062, 0.0060, 0.72 * r), axes))
    return union(*nails)


FINGERS = (
    ("Thumb", (0.014, 0.0110, 0.0102, 0.0078), 0.0205),
    ("Index", (0.0098, 0.0087, 0.0080, 0.0064), 0.0165),
    ("Middle", (0.0100, 0.0089, 0.0082, 0.0065), 0.0175),
    ("Ring", (0.0096, 0.0084, 0.0077, 0.0062), 0.0170),
    ("Little", (0.0086, 0.0074, 0.0068, 0.0055), 0.0150),
)


def _flat_cone(q: Points, a: np.ndarray, b: np.ndarray, radius_a: float, radius_b: float) -> Distances:
    """A rounded cone squashed to 80 % of its height."""
    squash = np.array([1, 1.25, 1])
    return rounded_cone(q * squash.astype(q.dtype), a * squash, b * squash, radius_a, radius_b) * 0.9
