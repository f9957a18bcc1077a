"""The character's clothes as signed distances, built on the rest pose of `HUMANOID` (metres, T-pose).

A bomber jacket worn open over a T-shirt, slim turned-up trousers, low trainers. Lofts give the silhouette. Every
piece is closed, so that it can be meshed on its own. The left half is modelled, the right half mirrored.
"""

import numpy as np

from .sdf import (
    Distances,
    Points,
    carve,
    common,
    ellipsoid,
    loft,
    mirrored,
    rounded_cone,
    slab,
    smooth_max,
    smooth_min,
    union,
)

HEM, CUFF = (0.985, 0.632)  # where the jacket's ribbing begins: height, and distance from the middle along the arm

# height, half width, centre x, half depth, centre z
TORSO = [
    (0.90, 0.160, 0, 0.104, -0.010),
    (0.96, 0.163, 0, 0.108, -0.008),
    (1.03, 0.146, 0, 0.100, -0.002),
    (1.10, 0.134, 0, 0.094, 0.000),
    (1.18, 0.139, 0, 0.099, 0.000),
    (1.27, 0.152, 0, 0.108, -0.006),
    (1.34, 0.152, 0, 0.102, -0.014),
    (1.40, 0.128, 0, 0.080, -0.024),
    (1.44, 0.066, 0, 0.062, -0.028),
    (1.47, 0.054, 0, 0.054, -0.026),
]
JACKET = [
    (0.90, 0.177, 0, 0.127, -0.007),
    (0.960, 0.175, 0, 0.125, -0.006),
    (1.000, 0.183, 0, 0.133, -0.004),
    (1.040, 0.180, 0, 0.132, -0.002),
    (1.12, 0.164, 0, 0.120, -0.001),
    (1.20, 0.162, 0, 0.119, -0.003),
    (1.28, 0.170, 0, 0.124, -0.007),
    (1.34, 0.167, 0, 0.117, -0.014),
    (1.40, 0.135, 0, 0.094, -0.024),
    (1.445, 0.078, 0, 0.074, -0.029),
    (1.48, 0.066, 0, 0.066, -0.029),
]
# distance from the middle, half height, centre y, half depth, centre z
SLEEVE = [
    (0.08, 0.082, 1.372, 0.082, -0.022),
    (0.15, 0.072, 1.378, 0.076, -0.024),
    (0.20, 0.063, 1.387, 0.069, -0.025),
    (0.30, 0.056, 1.392, 0.061, -0.025),
    (0.425, 0.051, 1.394, 0.055, -0.025),
    (0.52, 0.049, 1.394, 0.052, -0.024),
    (0.60, 0.047, 1.393, 0.049, -0.024),
    (0.635, 0.042, 1.394, 0.044, -0.024),
    (0.67, 0.034, 1.394, 0.037, -0.024),
]
LEG = [
    (0.06, 0.046, 0.092, 0.050, -0.014),
    (0.12, 0.046, 0.092, 0.051, -0.017),
    (0.20, 0.048, 0.092, 0.054, -0.019),
    (0.32, 0.055, 0.093, 0.062, -0.016),
    (0.42, 0.055, 0.093, 0.061, -0.006),
    (0.505, 0.057, 0.092, 0.061, 0.002),
    (0.58, 0.062, 0.092, 0.066, 0.003),
    (0.70, 0.073, 0.093, 0.079, 0.000),
    (0.80, 0.082, 0.092, 0.090, -0.004),
    (0.88, 0.083, 0.087, 0.097, -0.008),
    (0.93, 0.078, 0.081, 0.098, -0.009),
]
# distance from the heel's end (z), half width, centre x, half height, centre y
SHOE = [
    (-0.086, 0.026, 0.092, 0.036, 0.040),
    (-0.070, 0.034, 0.092, 0.046, 0.046),
    (-0.030, 0.037, 0.092, 0.054, 0.048),
    (0.010, 0.039, 0.092, 0.055, 0.040),
    (0.050, 0.043, 0.093, 0.046, 0.030),
    (0.095, 0.048, 0.095, 0.034, 0.026),
    (0.135, 0.047, 0.096, 0.028, 0.024),
    (0.165, 0.038, 0.096, 0.023, 0.022),
    (0.184, 0.022, 0.095, 0.016, 0.021),
]
SOLE = [(z, w + 0.0045, x, 0.03, 0.01) for z, w, x, _, _ in SHOE]


def shirt(p: Points) -> Distances:
    """A crew-neck T-shirt, seen in the jacket's opening."""
    d = loft(p, 1, [(y, w + 0.007, x, h + 0.008, z) for y, w, x, h, z in TORSO])
    d = smooth_max(d, slab(p, 1, 0.943, 1.50), 0.006)
    return smooth_max(d, _tilted_ring(p, 1.444, 0.40), 0.006)


def shirt_collar(p: Points) -> Distances:
    """The ribbed neckline of the T-shirt."""
    ring = _tilted_ring(p, 1.442, 0.40)
    d = loft(p, 1, [(y, w + 0.007, x, h + 0.008, z) for y, w, x, h, z in TORSO])
    rim: Distances = np.hypot(d + 0.001, 0.55 * ring) - 0.0052
    return rim


def jacket(p: Points) -> Distances:
    """The jacket without its ribbing: blouson body, sleeves, open front."""
    q = mirrored(p)
    d = loft(q, 1, JACKET)
    d = smooth_max(d, slab(q, 1, HEM - 0.004, 1.452), 0.008)
    sleeve = smooth_max(loft(q, 0, SLEEVE), slab(q, 0, 0.02, CUFF + 0.004), 0.006)
    d = smooth_min(d, sleeve, 0.055)
    d = d - _folds(q)
    return carve(d, _opening(q, 0.0), 0.007)


def ribbing(p: Points) -> Distances:
    """Hem, cuffs and collar."""
    q = mirrored(p)
    hem = smooth_max(
        loft(q, 1, [(y, w + 0.002, x, h + 0.002, z) for y, w, x, h, z in JACKET[:3]]), slab(q, 1, 0.925, HEM), 0.010
    )
    hem = carve(hem - _ribs(np.arctan2(q[:, 0], q[:, 2]), 40), _opening(q, 0.0), 0.007)
    cuff = smooth_max(
        loft(q, 0, [(x, h + 0.000, y, w + 0.000, z) for x, h, y, w, z in SLEEVE[-3:]]), slab(q, 0, CUFF, 0.678), 0.007
    )
    wall = loft(
        q, 1, [(1.40, 0.080, 0, 0.080, -0.030), (1.44, 0.070, 0, 0.071, -0.029), (1.50, 0.064, 0, 0.066, -0.030)]
    )
    collar = smooth_max(np.abs(wall) - 0.0060, _tilted_band(q, 1.425, 1.478), 0.010)
    collar = carve(collar, _opening(q, 0.010), 0.007)
    return union(hem, cuff, collar)


def stripes(p: Points) -> Distances:
    """Coral bands woven into the cuffs and the hem."""
    q = mirrored(p)
    cuff = loft(q, 0, [(x, h + 0.0018, y, w + 0.0018, z) for x, h, y, w, z in SLEEVE[-3:]])
    cuff = smooth_max(cuff, slab(q, 0, 0.650, 0.658), 0.002)
    hem = loft(q, 1, [(y, w + 0.0060, x, h + 0.0060, z) for y, w, x, h, z in JACKET[:3]])
    hem = carve(smooth_max(hem, slab(q, 1, 0.947, 0.957), 0.002), _opening(q, -0.001), 0.006)
    return union(cuff, hem)


def pockets(p: Points) -> Distances:
    """Slanted welts on the jacket's front."""
    q = mirrored(p)
    flat = np.stack([q[:, 0], q[:, 1], loft(q, 1, JACKET)], 1)
    welt = rounded_cone(flat * (1, 1, 1.6), (0.098, 1.105, 0.002), (0.128, 1.040, 0.002), 0.0062, 0.0062)
    return common(welt, -q[:, 2])


def zips(p: Points) -> Distances:
    """The two metal edges of the open zip."""
    q = mirrored(p)
    surface = np.abs(loft(q, 1, JACKET) + 0.001)
    return common(np.hypot(surface, _opening(q, 0.0)) - 0.0036, np.maximum(slab(q, 1, 0.932, 1.395), -q[:, 2]))


def trousers(p: Points) -> Distances:
    """Slim trousers down to the turn-ups."""
    q = mirrored(p)
    pelvis = smooth_max(
        loft(q, 1, [(y, w - 0.010, x, h - 0.007, z) for y, w, x, h, z in TORSO[:4]]), slab(q, 1, 0.89, 1.03), 0.02
    )
    leg = smooth_max(loft(q, 1, LEG), slab(q, 1, 0.105, 0.93), 0.006)
    d: Distances = smooth_min(pelvis, leg, 0.05) - _creases(q)
    return d


def turn_ups(p: Points) -> Distances:
    """The turned-up hems of the trousers."""
    q = mirrored(p)
    return smooth_max(
        loft(q, 1, [(y, w + 0.004, x, h + 0.004, z) for y, w, x, h, z in LEG[:3]]), slab(q, 1, 0.098, 0.136), 0.006
    )


def socks(p: Points) -> Distances:
    """Ankles, seen when a foot bends."""
    return rounded_cone(mirrored(p), (0.092, 0.070, -0.020), (0.092, 0.150, -0.020), 0.034, 0.034)


def shoes(p: Points) -> Distances:
    """Uppers of the trainers, open at the ankle."""
    q = mirrored(p)
    d = smooth_max(loft(q, 2, SHOE), slab(q, 2, -0.084, 0.183), 0.016)
    d = smooth_max(d, 0.012 - q[:, 1], 0.004)
    collar = ellipsoid(q, (0.092, 0.128, -0.026), (0.036, 0.052, 0.046))
    return carve(d, collar, 0.008)


def soles(p: Points) -> Distances:
    """Flat soles that stand on the floor."""
    q = mirrored(p)
    d = smooth_max(loft(q, 2, SOLE), slab(q, 2, -0.089, 0.187), 0.012)
    spring = 0.012 * np.clip((q[:, 2] - 0.12) / 0.07, 0, 1) ** 2
    return smooth_max(d, common(0.0005 + spring - q[:, 1], q[:, 1] - 0.0245 - 0.4 * spring), 0.006)


def laces(p: Points) -> Distances:
    """Four bars across each instep."""
    q = mirrored(p)
    bars = [
        rounded_cone(q, (0.072, y, z), (0.114, y, z), 0.0038, 0.0038)
        for z, y in ((0.018, 0.0905), (0.038, 0.0815), (0.058, 0.0715), (0.078, 0.0625))
    ]
    return union(*bars)


def _opening(q: Points, extra: float) -> Distances:
    """The open front: a gap that is widest at the chest, in front of the body's middle."""
    half = np.interp(q[:, 1], [0.92, 1.05, 1.25, 1.38, 1.50], [0.052, 0.046, 0.050, 0.056, 0.050]) + extra
    gap: Distances = common(q[:, 0] - half.astype(q.dtype), -0.01 - q[:, 2])
    return gap


def _tilted_ring(p: Points, height: float, tilt: float) -> Distances:
    """Height above a plane that falls towards the front."""
    ring: Distances = p[:, 1] - height + tilt * (p[:, 2] + 0.028)
    return ring


def _tilted_band(p: Points, low: float, high: float) -> Distances:
    """The layer between two planes that fall towards the front."""
    above = _tilted_ring(p, high, 0.22)
    below = -_tilted_ring(p, low, 0.22)
    return common(above, below)


def _ribs(angle: Distances, count: int) -> Distances:
    ribs: Distances = (0.0007 * np.sin(count * angle)).astype(angle.dtype)
    return ribs


def _folds(q: Points) -> Distances:
    """Soft cloth folds: gathered above the hem and cuffs, at the elbow, and fanning from the armpit."""
    angle = np.arctan2(q[:, 0], q[:, 2])
    gather = np.sin(11 * angle + 14 * q[:, 1]) + 0.6 * np.sin(17 * angle - 20 * q[:, 1])
    hem = np.exp(-(((q[:, 1] - 1.015) / 0.032) ** 2)) * gather * (q[:, 0] < 0.25)
    around = np.arctan2(q[:, 1] - 1.394, q[:, 2] + 0.024)
    inner = 0.5 + 0.5 * np.cos(around)  # towards the front, where the elbow bends
    elbow = np.exp(-(((q[:, 0] - 0.425) / 0.05) ** 2)) * inner * np.sin(125 * q[:, 0] + 1.2 * np.sin(2 * around))
    sleeve = np.exp(-(((q[:, 0] - 0.60) / 0.035) ** 2)) * np.sin(
        150 * q[:, 0] + 2.2 * np.sin(around + 1) + np.sin(3 * around)
    )
    pit = np.exp(-(((q[:, 0] - 0.18) / 0.06) ** 2 + ((q[:, 1] - 1.33) / 0.05) ** 2)) * np.sin(
        75 * (q[:, 0] + 0.8 * q[:, 1])
    )
    folds: Distances = (0.0017 * hem + 0.0022 * elbow + 0.0016 * sleeve + 0.0030 * pit).astype(q.dtype)
    return folds


def _creases(q: Points) -> Distances:
    """Trouser folds: fanning from the crotch, behind and over the knee, stacked above the turn-ups."""
    around = np.arctan2(q[:, 0] - 0.092, q[:, 2])
    stack = np.exp(-(((q[:, 1] - 0.175) / 0.035) ** 2)) * np.sin(
        120 * q[:, 1] + 1.5 * np.sin(around) + 0.8 * np.sin(3 * around)
    )
    knee = (
        np.exp(-(((q[:, 1] - 0.50) / 0.06) ** 2))
        * np.sin(80 * q[:, 1] + 2.0 * np.cos(around))
        * (0.6 - 0.4 * np.cos(around))
    )
    fan = np.exp(-(((q[:, 0] - 0.03) / 0.06) ** 2 + ((q[:, 1] - 0.86) / 0.045) ** 2)) * np.sin(
        70 * (q[:, 1] + 0.7 * q[:, 0])
    )
    creases: Distances = (0.0018 * stack + 0.0016 * knee + 0.0020 * fan).astype(q.dtype)
    return creases
