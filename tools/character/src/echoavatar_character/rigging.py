"""Skin weights: how much each bone of `HUMANOID` moves each vertex, from distances in the rest pose."""

import numpy as np
from jaxtyping import Float, Int

from echoavatar.motion.kinematics import HUMANOID

from .sdf import Points, rise, rounded_cone, union

INFLUENCES = 4
SOFTNESS = 0.016  # metres over which a joint's influence fades
REST = HUMANOID.rest_positions.numpy().astype(np.float64)
Weights = Float[np.ndarray, "v j"]

RADII = {
    **{"hips": 0.115, "spine": 0.115, "chest": 0.118, "upperChest": 0.105, "neck": 0.05, "head": 0.08},
    **{"Shoulder": 0.055, "UpperArm": 0.052, "LowerArm": 0.045, "Hand": 0.026},
    **{"UpperLeg": 0.078, "LowerLeg": 0.055, "Foot": 0.040, "Toes": 0.030},
}
TRUNK = ("hips", "spine", "chest", "upperChest")
ARMS = ("Shoulder", "UpperArm", "LowerArm")


def weigh(piece: str, points: Points) -> Weights:
    """Weights (rows sum to 1) of a piece's vertices over the 52 joints, before smoothing."""
    if piece in ("hair", "brows", "lashes", "left eye", "right eye", "upper teeth", "lower teeth", "tongue"):
        return _ramp(points, ("head",), [])
    if piece == "skin":
        tilted = points[:, 1] + 0.6 * (points[:, 2] + 0.005)
        return _ramp(points, ("upperChest", "neck", "head"), [rise(points[:, 1], 1.40, 1.46), rise(tilted, 1.46, 1.53)])
    if piece == "crew neck":
        return _ramp(points, ("upperChest", "neck"), [0.25 * rise(points[:, 1], 1.40, 1.46)])
    if piece == "hands":
        return _hand_weights(points)
    if piece in ("shoes", "soles", "laces"):
        return _sided(points, ("Foot", "Toes"), [rise(points[:, 2], 0.080, 0.135)])
    if piece == "socks":
        return _sided(points, ("LowerLeg", "Foot"), [1 - rise(points[:, 1], 0.075, 0.125)])
    if piece in ("trousers", "turn-ups"):
        return _near(points, ("hips", "spine"), ("UpperLeg", "LowerLeg"))
    return _near(points, TRUNK, ARMS)


def smooth(weights: Weights, points: Points, *, passes: int, neighbours: int = 14) -> Weights:
    """Average over the nearest neighbours in space, so that layers on top of each other move alike."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(points).query(points, neighbours)
    share = np.exp(-((distance / 0.02) ** 2))
    share /= share.sum(1, keepdims=True)
    for _ in range(passes):
        weights = np.einsum("vn,vnj->vj", share, weights[index])
    return weights


def strongest(weights: Weights) -> tuple[Int[np.ndarray, "v 4"], Float[np.ndarray, "v 4"]]:
    """The four strongest joints of each vertex and their shares, which sum to 1."""
    joints = np.argsort(-weights, axis=1)[:, :INFLUENCES]
    shares = np.take_along_axis(weights, joints, 1)
    shares = np.where(shares < 0.004, 0, shares)
    return joints.astype(np.uint8), (shares / shares.sum(1, keepdims=True)).astype(np.float32)


def _near(points: Points, centre: tuple[str, ...], sided: tuple[str, ...]) -> Weights:
    """Softmax over distances to the bones' capsules; left points never follow right limbs."""
    weights = np.zeros((len(points), HUMANOID.joints))
    names = [*centre, *(f"{side}{bone}" for side in ("left", "right") for bone in sided)]
    cost = np.stack([_bone_distance(points, name) for name in names], 1)
    for column, name in enumerate(names):
        sign = {"l": 1.0, "r": -1.0}[name[0]] if name.startswith(("left", "right")) else 0.0
        cost[:, column] += np.clip(-sign * points[:, 0], 0, None) * 4
    share = np.exp(-(cost - cost.min(1, keepdims=True)) / SOFTNESS)
    weights[:, HUMANOID.indices(names)] = share / share.sum(1, keepdims=True)
    return weights


def _bone_distance(points: Points, name: str) -> Float[np.ndarray, " v"]:
    joint = HUMANOID.index(name)
    kind = name.removeprefix("left").removeprefix("right")
    follow = {"hips": "spine", "spine": "chest", "chest": "upperChest", "upperChest": "neck"}
    chain = {
        "Shoulder": "UpperArm",
        "UpperArm": "LowerArm",
        "LowerArm": "Hand",
        "UpperLeg": "LowerLeg",
        "LowerLeg": "Foot",
    }
    end = follow.get(name) or name[: -len(kind)] + chain[kind]
    start, stop = REST[joint], REST[HUMANOID.index(end)]
    if name == "hips":
        start = start - (0, 0.06, 0)
    squash = np.array([0.78, 1.0, 1.0]) if name in TRUNK else np.ones(3)  # trunks are wider than deep
    return rounded_cone(points * squash, start * squash, stop * squash, RADII[kind], RADII[kind])


def _hand_weights(points: Points) -> Weights:
    """The wrist by distance along the arm, a finger by the nearest finger and then along it, never across."""
    weights = np.zeros((len(points), HUMANOID.joints))
    folded = points * np.stack([np.sign(points[:, 0]), *np.ones((2, len(points)))], 1)
    left = {name[4:]: i for i, name in enumerate(HUMANOID.names) if name.startswith("left")}
    chains = [[left[n] for n in left if n.startswith(f)] for f in ("Thumb", "Index", "Middle", "Ring", "Little")]
    gaps = np.stack([_chain_distance(folded, chain) for chain in chains], 1)
    nearest = gaps.argmin(1)
    local = np.zeros((len(points), HUMANOID.joints))
    to_hand = rise(folded[:, 0], 0.650, 0.690)
    local[:, left["LowerArm"]], local[:, left["Hand"]] = 1 - to_hand, to_hand
    for finger, chain in enumerate(chains):
        rows = np.flatnonzero(nearest == finger)
        _bend(local, rows, folded[rows], [left["Hand"], *chain], thumb=finger == 0)
    mirror = np.asarray(HUMANOID.config.mirror)
    is_left = points[:, 0] > 0
    weights[is_left], weights[~is_left] = local[is_left], local[~is_left][:, mirror]
    return weights


def _bend(weights: Weights, rows: np.ndarray, points: Points, chain: list[int], *, thumb: bool) -> None:
    """Blend from each bone of a finger to the next around the plane of the joint, in place."""
    for parent, joint, onward in zip(chain[:-1], chain[1:], [*chain[2:], -1], strict=True):
        way = REST[onward] - REST[joint] if onward >= 0 else REST[joint] - REST[parent]
        if joint == chain[1] and not thumb:
            way = np.array([1.0, 0.0, 0.0])
        along = (points - REST[joint]) @ (way / np.linalg.norm(way))
        if joint == chain[1]:
            low, high = (-0.008, 0.024) if thumb else (-0.012, 0.012)
        else:
            low, high = -0.007, 0.007
        share = rise(along, low, high)
        moved = weights[rows, parent] * share
        weights[rows, joint] += moved
        weights[rows, parent] -= moved


def _chain_distance(points: Points, chain: list[int]) -> Float[np.ndarray, " v"]:
    bones = REST[chain]
    tip = bones[-1] + (bones[-1] - bones[-2])
    ends = [*bones, tip]
    return union(*(rounded_cone(points, a, b, 0.009, 0.009) for a, b in zip(ends[:-1], ends[1:], strict=True)))


def _ramp(points: Points, names: tuple[str, ...], rises: list[np.ndarray]) -> Weights:
    """Weights that pass from each name to the next by the given shares."""
    weights = np.zeros((len(points), HUMANOID.joints))
    left = np.ones(len(points))
    for name, share in zip(names, [*rises, np.zeros(len(points))], strict=True):
        weights[:, HUMANOID.index(name)] = left * (1 - share)
        left = left * share
    return weights


def _sided(points: Points, kinds: tuple[str, ...], rises: list[np.ndarray]) -> Weights:
    left = _ramp(points, tuple(f"left{kind}" for kind in kinds), rises)
    right = _ramp(points, tuple(f"right{kind}" for kind in kinds), rises)
    return np.where(points[:, :1] > 0, left, right)
