"""The thickness of a character: ellipsoids on the bones of spine and head, and half the thickness of a hand.

The paper sets the radii around the spine by hand for one model. Here they are data: measured on a skinned mesh in its
rest pose (`measure_body`), scaled from bone lengths (`body_of_rig`), or read from a JSON file that can be edited by
hand.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field, ValidationError
from scipy.sparse import csr_array

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.whole_file import write_whole

from ..kinematics import HUMANOID, Skeleton
from ..kinematics.rigs import bone_map

COLUMN = ("hips", "spine", "chest", "upperChest", "neck", "head")
Vector = tuple[float, float, float]


class RoundedPart(Config):
    """An ellipsoid that moves with a bone; its axes are those of the bone (rest: x left, y up, z ahead)."""

    bone: Literal["hips", "spine", "chest", "upperChest", "neck", "head"] = Field(
        description="VRM bone that carries it"
    )
    centre: Vector = Field(description="from the bone's joint, in its frame, metres")
    radii: Vector = Field(description="half axes: half width, half height, half depth, metres")


class BodyProfile(Config):
    """The body that hands must not enter, and the hands' own thickness. Metres."""

    parts: tuple[RoundedPart, ...] = Field(min_length=1, description="torso, neck and head, from below")
    palm: float = Field(0.020, ge=0, description="half the thickness of wrist and palm")
    finger: float = Field(0.010, ge=0, description="half the thickness of a finger")

    def save(self, path: Path) -> None:
        """Write the profile as JSON; raises MotionError where it cannot be written."""
        write_whole(path, self.model_dump_json(indent=1) + "\n", error=MotionError)

    def scaled(self, factor: float) -> "BodyProfile":
        """The profile of a body so many times as large."""

        def larger(vector: Vector) -> Vector:
            x, y, z = vector
            return factor * x, factor * y, factor * z

        parts = [RoundedPart(bone=p.bone, centre=larger(p.centre), radii=larger(p.radii)) for p in self.parts]
        return BodyProfile(parts=tuple(parts), palm=factor * self.palm, finger=factor * self.finger)

    @classmethod
    def load(cls, path: Path) -> "BodyProfile":
        """Read a file of `save`. Raises MotionError if it is missing or not a profile."""
        try:
            return cls.model_validate(read_object_file(path))
        except OSError as error:
            raise MotionError(f"the body profile {path} cannot be read; check the name") from error
        except EchoAvatarError as error:
            raise MotionError(f"{path} is not a body profile: {error}; measure the character anew") from error
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise MotionError(
                f"{path} is not a body profile: {where}: {first['msg']}; measure the character anew"
            ) from error


def body_of_rig(skeleton: Skeleton) -> BodyProfile:
    """A profile for a rig without a mesh: our character's, scaled to the rig's trunk, neck and shoulder breadth.

    Raises MotionError when the rig's bones are not known.
    """
    bones, ours = bone_map(skeleton), bone_map(HUMANOID)

    def ratio(start: str, end: str) -> float:
        """The distance between two joints of the rig, relative to ours."""
        theirs, own = (
            (rig.rest_positions[joints[start]] - rig.rest_positions[joints[end]]).norm()
            for rig, joints in ((skeleton, bones), (HUMANOID, ours))
        )
        return float(theirs) / float(own)

    tall, hand = ratio("head", "hips"), ratio("leftHand", "leftLowerArm")
    thick = min(ratio("leftUpperArm", "rightUpperArm"), 1.25 * tall)
    parts = []
    for part in _OURS.parts:
        if part.bone not in bones:
            continue
        middle = HUMANOID.rest_positions[ours[part.bone], 1].item() + part.centre[1]
        hips = HUMANOID.rest_positions[ours["hips"], 1].item()
        height = skeleton.rest_positions[bones["hips"], 1].item() + tall * (middle - hips)
        up = height - skeleton.rest_positions[bones[part.bone], 1].item()
        x, y, z = part.radii
        parts.append(
            RoundedPart(
                bone=part.bone,
                centre=(part.centre[0], up, part.centre[2] * thick),
                radii=(x * thick, y * tall, z * thick),
            )
        )
    return BodyProfile(parts=tuple(parts), palm=_OURS.palm * hand, finger=_OURS.finger * hand)


def _ours() -> BodyProfile:
    """The profile of the first shipped character without her hair, as `measure_body` gives it."""
    rows: tuple[tuple[str, Vector, Vector], ...] = (
        ("hips", (0.0, 0.0133, 0.007), (0.1955, 0.1349, 0.1408)),
        ("spine", (0.0, 0.0576, 0.027), (0.1975, 0.1262, 0.1395)),
        ("chest", (0.0, 0.0625, 0.0327), (0.2487, 0.1374, 0.143)),
        ("upperChest", (0.0, 0.0825, 0.0128), (0.2717, 0.1402, 0.1368)),
        ("neck", (0.0, 0.0405, 0.0058), (0.0402, 0.0594, 0.0419)),
        ("head", (0.0, 0.0499, 0.0295), (0.0949, 0.1367, 0.1126)),
    )
    parts = [{"bone": bone, "centre": centre, "radii": radii} for bone, centre, radii in rows]
    return BodyProfile.model_validate({"parts": parts, "palm": 0.019, "finger": 0.0117})


_OURS = _ours()


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
    skeleton: Skeleton, vertices: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"] | csr_array
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
    weights = csr_array(weights)
    if not (np.isfinite(vertices).all() and np.isfinite(weights.data).all()):
        raise MotionError("the mesh holds numbers that are not finite; export it again")
    bones, vertices = bone_map(skeleton), np.round(vertices, 4)  # so that no slice depends on rounding
    fits = _tightened(_slices(skeleton, bones, vertices, weights))
    if not fits:
        raise MotionError(f"no part of the trunk has {FEWEST} vertices; check the weights")
    rest = skeleton.rest_positions.numpy()
    parts = []
    for fit in fits:
        centre, radii = (np.round(v, 4).tolist() for v in (fit.middle - [0, *rest[bones[fit.bone], 1:]], fit.radii))
        parts.append(RoundedPart.model_validate({"bone": fit.bone, "centre": centre, "radii": radii}))
    return BodyProfile(parts=tuple(parts), **_hand(skeleton, bones, vertices, weights))


def _slices(
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: csr_array
) -> list[_Fit]:
    """Cut the body at the joints of the spine, and put a generous ellipsoid around each slice."""
    column = [bone for bone in COLUMN if bone in bones]
    rest = np.round(skeleton.rest_positions.numpy(), 4)
    is_head = weights[:, [bones["head"]]].sum(1) > 0.5
    head = vertices[is_head]
    if len(head) < FEWEST:
        raise MotionError(f"{len(head)} vertices follow the head, {FEWEST} are needed; check the weights")
    trunk = vertices[(weights[:, [bones[bone] for bone in column]].sum(1) > 0.5) & ~is_head]
    head, trunk = _thinned(head), _thinned(trunk)
    arm = rest[bones["leftUpperArm"]]
    is_shoulder = (np.abs(trunk[:, 0]) > CHEST * abs(arm[0])) & (trunk[:, 1] > arm[1] - 0.4 * abs(arm[0]))
    trunk = trunk[~is_shoulder]
    if not len(trunk):
        raise MotionError(f"no vertex follows the trunk, and {FEWEST} of a bone are needed; check the weights")
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
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: csr_array
) -> dict[str, float]:
    """Half thickness of palm and fingers: the 80th percentile of their skin's height above or below the bones."""
    found = {}
    owner = _strongest(weights)
    fingers = [f"left{digit}{part}" for digit in ("Index", "Middle") for part in ("Proximal", "Intermediate")]
    for name, owners in (("palm", ["leftHand"]), ("finger", fingers)):
        skin = np.isin(owner, [bones[bone] for bone in owners if bone in bones])
        if skin.sum() >= FEWEST:
            away = vertices[skin, 1] - skeleton.rest_positions.numpy()[owner[skin], 1]
            found[name] = round(float(np.quantile(np.abs(away), 0.8)), 4)
    return found


def _strongest(weights: csr_array) -> Int[np.ndarray, " v"]:
    """The joint with the largest weight of each vertex, the first of several; 0 where there is none."""
    owner, most = np.zeros(weights.shape[0], int), np.zeros(weights.shape[0], weights.dtype)
    vertex = np.repeat(np.arange(len(owner)), np.diff(weights.indptr))
    np.maximum.at(most, vertex, weights.data)
    strongest = np.flatnonzero((weights.data == most[vertex]) & (weights.data > 0))[::-1]
    owner[vertex[strongest]] = weights.indices[strongest]  # the last one that is written stays
    return owner
