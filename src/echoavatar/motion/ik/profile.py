"""The thickness of a character: ellipsoids on the bones of spine and head, and half the thickness of a hand.

The paper sets the radii around the spine by hand for one model. Here they are data: measured on a skinned mesh in its
rest pose (`measure_body`), scaled from bone lengths (`body_of_rig`), or read from a JSON file that can be edited by
hand.
"""

from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.whole_file import write_whole

from ..kinematics import HUMANOID, Skeleton, SkinWeights
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
        """The profile of a body `factor` times as large."""
        parts = [
            {"bone": part.bone} | {key: (factor * np.array(getattr(part, key))).tolist() for key in ("centre", "radii")}
            for part in self.parts
        ]
        sizes = {"palm": factor * self.palm, "finger": factor * self.finger}
        return BodyProfile.model_validate({"parts": parts, **sizes})

    @classmethod
    def load(cls, path: Path) -> "BodyProfile":
        """Read a file that `save` wrote. Raises MotionError if it is missing or not a profile."""
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
            np.linalg.norm(rig.rest_positions[joints[start]] - rig.rest_positions[joints[end]])
            for rig, joints in ((skeleton, bones), (HUMANOID, ours))
        )
        return float(theirs) / float(own)

    tall, hand = ratio("head", "hips"), ratio("leftHand", "leftLowerArm")
    thick = min(ratio("leftUpperArm", "rightUpperArm"), 1.25 * tall)
    parts = []
    (heights, own), hips = (rig.rest_positions[:, 1].tolist() for rig in (skeleton, HUMANOID)), ours["hips"]
    for part in _OURS.parts:
        if part.bone in bones:
            (left, up, ahead), (x, y, z) = part.centre, part.radii
            above = heights[bones["hips"]] - heights[bones[part.bone]]
            up = above + tall * (own[ours[part.bone]] + up - own[hips])
            centre, radii = (left, up, ahead * thick), (x * thick, y * tall, z * thick)
            parts.append(RoundedPart(bone=part.bone, centre=centre, radii=radii))
    return BodyProfile(parts=tuple(parts), palm=_OURS.palm * hand, finger=_OURS.finger * hand)


# the profile that `measure_body` gives for Maya, the first shipped character, without her hair: bone, centre, radii
_ROWS: tuple[tuple[str, Vector, Vector], ...] = (
    ("hips", (0.0, 0.0133, 0.0074), (0.1779, 0.1357, 0.133)),
    ("spine", (0.0, 0.0575, 0.0324), (0.1682, 0.1265, 0.1168)),
    ("chest", (0.0, 0.0625, 0.0359), (0.2278, 0.1375, 0.1396)),
    ("upperChest", (0.0, 0.0825, 0.0197), (0.2579, 0.1402, 0.1414)),
    ("neck", (0.0, 0.0475, 0.016), (0.0539, 0.0713, 0.0372)),
    ("head", (0.0, 0.052, 0.0326), (0.1067, 0.148, 0.1257)),
)
_PARTS = [{"bone": bone, "centre": centre, "radii": radii} for bone, centre, radii in _ROWS]
_OURS = BodyProfile.model_validate({"parts": _PARTS, "palm": 0.019, "finger": 0.0117})

SHAPES = {  # ellipsoids: height over that of the slice; percentile that gives the depth; percent of the slice inside
    "hips": (2.2, 98, 94),
    "upperChest": (1.7, 92, 92),
    "neck": (1.5, 90, 30),  # most of its slice belongs to the shoulders
    "head": (1.08, 99, 87),
}
OTHER_SHAPE = (2.2, 95, 93)
WIDTH = 98  # the percentile that gives the width of all ellipsoids
CHEST = 0.72  # of the way to the shoulder joints: near their height, points further out do not belong to the chest
GRID = 0.015  # metres
FEWEST = 24  # vertices of the head, points of the grid in a slice


def measure_body(skeleton: Skeleton, vertices: Float[np.ndarray, "v 3"], weights: SkinWeights) -> BodyProfile:
    """Fit one ellipsoid per bone of spine, neck and head, to the slice of the body that begins at the bone.

    Args:
        skeleton: the rig of the mesh, Y up, facing +Z in its rest pose.
        vertices: rest positions, metres.
        weights: on joints of the rig.

    Raises:
        MotionError: mesh and rig do not fit each other, or the rig's bones are not known.
    """
    if vertices.shape[1:] != (3,) or len(weights.shares) != len(vertices) or weights.joints.max() >= skeleton.joints:
        raise MotionError(
            f"vertices {vertices.shape} and weights {weights.shares.shape} do not fit a rig of {skeleton.joints}"
            " joints; pass one row of weights for each vertex"
        )
    if not (np.isfinite(vertices).all() and np.isfinite(weights.shares).all()):
        raise MotionError("the mesh holds numbers that are not finite; export it again")
    bones, rest = bone_map(skeleton), skeleton.rest_positions
    parts = []
    for bone, (middle, radii) in _slices(skeleton, bones, vertices, weights).items():
        centre, radii = (np.round(v, 4).tolist() for v in (middle - [0, *rest[bones[bone], 1:]], radii))
        parts.append(RoundedPart.model_validate({"bone": bone, "centre": centre, "radii": radii}))
    return BodyProfile(parts=tuple(parts), **_hand(skeleton, bones, vertices, weights))


def _slices(
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: SkinWeights
) -> dict[str, tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]]:
    """Cut the body at the joints of the spine: middle and radii of an ellipsoid around each slice, by its bone."""
    column = [bone for bone in COLUMN if bone in bones]
    rest = skeleton.rest_positions
    is_head = weights.on([bones["head"]]) > 0.5
    is_trunk = (weights.on([bones[bone] for bone in column]) > 0.5) & ~is_head
    if (count := int(is_head.sum())) < FEWEST:
        raise MotionError(f"{count} vertices follow the head, {FEWEST} are needed; check the weights")
    if not is_trunk.any():
        raise MotionError(f"no vertex follows the trunk, and {FEWEST} of a bone are needed; check the weights")
    head, (trunk, share) = _on_grid(vertices[is_head]), _on_grid(vertices[is_trunk])
    out, up = np.abs(rest[bones["leftUpperArm"], :2])
    share = share * (1 - _beyond(np.abs(trunk[:, 0]), CHEST * out) * _beyond(trunk[:, 1], up - 0.4 * out))
    low, high = vertices[is_head, 1].min(), vertices[is_head, 1].max()
    borders = [_percentile(trunk[:, 1], share, 1), *rest[[bones[bone] for bone in column[1:]], 1], high]
    found = {}
    for bone, bottom, top in zip(column, borders, borders[1:], strict=False):
        if bone == "head":
            found[bone] = _around(bone, *head, low, high)
            continue
        inside = share * _beyond(trunk[:, 1], bottom) * (1 - _beyond(trunk[:, 1], top))
        if inside.sum() >= FEWEST:
            found[bone] = _around(bone, trunk, inside, bottom, top)
    return found


def _on_grid(points: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """The nodes of a grid around points, and how near the nearest point is: 1 on a node, 0 from the next node on.

    A finely meshed mouth does not outvote the back of the skull, and points that move a little change little.
    """
    places = points.astype(np.float64) / GRID
    nodes = np.floor(places)[:, None] + np.indices((2, 2, 2)).reshape(3, 8).T
    found, slot = np.unique(nodes.reshape(-1, 3), axis=0, return_inverse=True)
    share = np.zeros(len(found))
    np.maximum.at(share, slot.ravel(), (1 - np.abs(places[:, None] - nodes)).prod(-1).ravel())
    return found * GRID, share


def _beyond(values: Float[np.ndarray, " n"], border: float) -> Float[np.ndarray, " n"]:
    """1 for values beyond a border and 0 below it, with a slope of one grid cell between."""
    beyond: np.ndarray = np.clip((values - border) / GRID + 0.5, 0, 1)
    return beyond


def _percentile(values: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"], percent: float) -> float:
    """The weighted percentile of the values, with each share spread over the cells that it touches."""
    first = np.floor(values.min() / GRID)
    places = values / GRID - first
    cell = places.astype(int)
    counts = np.bincount(np.append(cell, cell + 1), np.append(share * (1 - places % 1), share * (places % 1)))
    upto = np.append(0, counts.cumsum())
    return GRID * float(first - 0.5 + np.interp(percent / 100 * upto[-1], upto, np.arange(len(upto))))


def _around(
    bone: str, points: Float[np.ndarray, "n 3"], share: Float[np.ndarray, " n"], bottom: float, top: float
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    tall, depth, held = SHAPES.get(bone, OTHER_SHAPE)
    wide = _percentile(np.abs(points[:, 0]), share, WIDTH)
    back, front = (_percentile(points[:, 2], share, percent) for percent in (100 - depth, depth))
    middle = np.array([0, bottom + top, back + front]) / 2
    half = np.array([wide, tall * (top - bottom) / 2, (front - back) / 2])
    x, y, z = (((points - middle) / half) ** 2).T
    larger = _percentile(wide * np.sqrt((x + z) / np.maximum(1 - y, 0.05)), share, held) / wide
    return middle, half * [larger, 1, larger]


def _hand(
    skeleton: Skeleton, bones: dict[str, int], vertices: Float[np.ndarray, "v 3"], weights: SkinWeights
) -> dict[str, float]:
    """Half thickness of palm and fingers: the 80th percentile of their skin's height above or below the bones."""
    found = {}
    owner = weights.joints[np.arange(len(vertices)), weights.shares.argmax(1)]
    fingers = [f"left{digit}{part}" for digit in ("Index", "Middle") for part in ("Proximal", "Intermediate")]
    for name, owners in (("palm", ["leftHand"]), ("finger", fingers)):
        skin = np.isin(owner, [bones[bone] for bone in owners if bone in bones])
        if skin.sum() >= FEWEST:
            away = vertices[skin, 1] - skeleton.rest_positions[owner[skin], 1]
            found[name] = round(float(np.quantile(np.abs(away), 0.8)), 4)
    return found
