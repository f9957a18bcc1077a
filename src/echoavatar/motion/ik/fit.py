"""Measure a body profile on a skinned mesh in its rest pose."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.errors import MotionError

from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from .profile import COLUMN, BodyProfile, RoundedPart

HEIGHTS = {"upperChest": 1.7, "neck": 1.5, "head": 1.08}  # of an ellipsoid, relative to its slice of the body
TRUNK_HEIGHT = 2.2  # the same for the other slices
COVERED = 0.97  # share of a slice's vertices that must lie inside; the rest are hems, buckles, strands
CHEST = 0.72  # of the way to the shoulder joints: near their height, vertices further out do not belong to the chest
GRID = 0.015  # metres
FEWEST = 24  # vertices in a slice
ROUNDS, STEP = 20, 0.002  # of shrinking; metres per step


@dataclass
class _Fit:
    bone: str
    slice: Float[np.ndarray, "v 3"]  # the vertices that it must cover together with its neighbours
    middle: Float[np.ndarray, " 3"]
    radii: Float[np.ndarray, " 3"]

    def holds(self, points: Float[np.ndarray, "v 3"]) -> Bool[np.ndarray, " v"]:
        inside: np.ndarray = (((points - self.middle) / self.radii) ** 2).sum(1) <= 1
        return inside


def measure_body(
    skeleton: Skeleton, vertices: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"]
) -> BodyProfile:
    """Fit one ellipsoid per bone of spine, neck and head, to the slice of the body that begins at the bone.

    Args:
        skeleton: the rig of the mesh, Y up, facing +Z in its rest pose.
        vertices: rest positions, metres.
        weights: skinning weights over all joints of the rig, rows sum to 1.

    Raises:
        MotionError: mesh and rig do not fit each other, or the rig's bones are not known.
    """
    if vertices.shape[1:] != (3,) or weights.shape != (len(vertices), skeleton.joints):
        raise MotionError(
            f"vertices {vertices.shape} and weights {weights.shape} do not fit a rig of {skeleton.joints} joints;"
            " pass one row of weights over all joints for each vertex"
        )
    if not (np.isfinite(vertices).all() and np.isfinite(weights).all()):
        raise MotionError("the mesh holds numbers that are not finite; export it again")
    bones = bone_map(skeleton)
    fits = _tightened(_slices(skeleton, bones, vertices, weights))
    rest = skeleton.rest_positions.numpy()
    parts = []
    for fit in fits:
        centre, radii = (np.round(v, 4).tolist() for v in (fit.middle - [0, *rest[bones[fit.bone], 1:]], fit.radii))
        parts.append(RoundedPart.model_validate({"bone": fit.bone, "centre": centre, "radii": radii}))
    return BodyProfile(parts=tuple(parts), **_hand(skeleton, bones, vertices, weights))


def _slices(
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"]
) -> list[_Fit]:
    """Cut the body at the joints of the spine, and put a generous ellipsoid around each slice."""
    column = [bone for bone in COLUMN if bone in bones]
    rest = skeleton.rest_positions.numpy()
    is_head = weights[:, bones["head"]] > 0.5
    head = vertices[is_head]
    if len(head) < FEWEST:
        raise MotionError(f"{len(head)} vertices follow the head, {FEWEST} are needed; check the weights")
    trunk = vertices[(weights[:, [bones[bone] for bone in column]].sum(1) > 0.5) & ~is_head]
    head, trunk = _thinned(head), _thinned(trunk)
    arm = rest[bones["leftUpperArm"]]
    is_shoulder = (np.abs(trunk[:, 0]) > CHEST * abs(arm[0])) & (trunk[:, 1] > arm[1] - 0.4 * abs(arm[0]))
    trunk = trunk[~is_shoulder]
    floors = [float(rest[bones[bone], 1]) for bone in column] + [float(head[:, 1].max())]
    floors[0] = float(np.percentile(trunk[:, 1], 1))
    fits = []
    for bone, bottom, top in zip(column, floors, floors[1:], strict=False):
        inside = head if bone == "head" else trunk[(trunk[:, 1] >= bottom) & (trunk[:, 1] <= top)]
        if len(inside) >= FEWEST:
            fits.append(_around(bone, inside))
    return fits


def _thinned(points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
    """One vertex of each cell of a grid: a finely meshed mouth must not outvote the back of the skull."""
    return points[np.unique(np.round(points / GRID), axis=0, return_index=True)[1]]


def _around(bone: str, inside: Float[np.ndarray, "v 3"]) -> _Fit:
    low, high = np.percentile(inside, [1, 99], axis=0)
    low[1], high[1] = inside[:, 1].min(), inside[:, 1].max()
    high[0] = max(high[0], -low[0])
    low[0] = -high[0]
    middle, half = (low + high) / 2, (high - low) / 2
    half[1] *= HEIGHTS.get(bone, TRUNK_HEIGHT)
    away = ((inside - middle) / half) ** 2
    scale = np.sqrt(((away[:, 0] + away[:, 2]) / np.maximum(1 - away[:, 1], 0.05)).max())
    return _Fit(bone, inside, middle, half * np.array([scale, 1, scale]))


def _tightened(fits: list[_Fit]) -> list[_Fit]:
    """Shrink every ellipsoid at the front, back and sides while all of them together still cover every slice.

    None loses more than half of a radius: where neighbours reach over a short slice, it would vanish.
    """
    least = [fit.radii / 2 for fit in fits]
    steps = [np.array(step) for step in ((0, 0, -STEP), (0, 0, STEP), (0, 0, -STEP), (STEP, 0, 0))]
    for _ in range(ROUNDS):
        for i, fit in enumerate(fits):
            for step in steps:
                shift = step * [0, 0, 1]
                smaller = replace(fit, middle=fit.middle + shift, radii=fit.radii - np.abs(step))
                others = [*fits[:i], smaller, *fits[i + 1 :]]
                if (smaller.radii >= least[i]).all() and all(
                    _covered(part.slice, others) >= COVERED for part in others
                ):
                    fits[i] = fit = smaller
    return fits


def _covered(points: Float[np.ndarray, "v 3"], fits: list[_Fit]) -> float:
    return float(np.any([fit.holds(points) for fit in fits], axis=0).mean())


def _hand(
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"]
) -> dict[str, float]:
    """Half thickness of palm and fingers: the 80th percentile of their skin's height above or below the bones."""
    found = {}
    owner = weights.argmax(1)
    fingers = [f"left{digit}{part}" for digit in ("Index", "Middle") for part in ("Proximal", "Intermediate")]
    for name, owners in (("palm", ["leftHand"]), ("finger", fingers)):
        skin = np.isin(owner, [bones[bone] for bone in owners if bone in bones])
        if skin.sum() >= FEWEST:
            away = vertices[skin, 1] - skeleton.rest_positions.numpy()[owner[skin], 1]
            found[name] = round(float(np.quantile(np.abs(away), 0.8)), 4)
    return found
