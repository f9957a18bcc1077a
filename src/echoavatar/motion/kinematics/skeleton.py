"""A skeleton: joint names, parents, rest offsets, mirror pairs, body parts, foot joints and VRM bone map.

The paper's motion tokenizer splits the body into three anatomical parts: lower body, upper body and hands.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field, model_validator

from echoavatar.config import Config
from echoavatar.limits import JOINTS

_NO_NAME = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # a name becomes part of a line in BVH and CSV
_NAME = re.compile("[^\x00-\x1f\x7f-\x9f\u2028\u2029]{1,256}")
NAME_LETTERS = 240  # of a name that are kept; a number may follow


class SkeletonConfig(Config):
    """The stored form of a skeleton, part of every checkpoint and clip."""

    names: tuple[str, ...] = Field(description="joint names, parents before children")
    parents: tuple[int, ...] = Field(description="index of each joint's parent, -1 for the root")
    offsets: tuple[tuple[float, float, float], ...] = Field(description="rest offset from the parent, metres")
    parts: dict[str, tuple[int, ...]] = Field(default_factory=dict, description="joints of each body part")
    mirror: tuple[int, ...] = Field(default=(), description="for each joint the joint on the other side")
    feet: tuple[int, ...] = Field(default=(), description="left ankle, left toes, right ankle, right toes")
    tips: dict[str, tuple[float, float, float]] = Field(
        default_factory=dict, description="offset from a joint to the free end of its bone, metres"
    )
    vrm: dict[str, int] = Field(default_factory=dict, description="VRM 1.0 humanoid bone name to joint")

    @model_validator(mode="after")
    def _is_a_tree(self) -> "SkeletonConfig":
        if len(self.names) > JOINTS:
            raise ValueError(f"{len(self.names)} joints, and a skeleton has at most {JOINTS}")
        if not (len(self.names) == len(self.parents) == len(self.offsets)):
            raise ValueError(
                f"{len(self.names)} names, {len(self.parents)} parents, {len(self.offsets)} offsets differ"
            )
        if len(set(self.names)) != len(self.names):
            raise ValueError("joint names must be unique")
        for name in self.names:
            if not _NAME.fullmatch(name):
                raise ValueError(
                    f"{name[:80]!r} is no name of a joint: it has no letter, too many, or control characters"
                )
        if not self.names or self.parents[0] != -1:
            raise ValueError("the first joint must be the root (parent -1)")
        for joint, parent in enumerate(self.parents[1:], start=1):
            if not 0 <= parent < joint:
                raise ValueError(f"joint {self.names[joint]} must come after its parent, got parent {parent}")
        return self

    @model_validator(mode="after")
    def _names_its_own_joints(self) -> "SkeletonConfig":
        named = [*self.mirror, *self.feet, *self.vrm.values()]
        named += [joint for part in self.parts.values() for joint in part]
        for joint in named:
            if not 0 <= joint < len(self.names):
                raise ValueError(f"parts, mirror, feet or vrm name joint {joint} of {len(self.names)}")
        if not all(math.isfinite(value) for offset in (*self.offsets, *self.tips.values()) for value in offset):
            raise ValueError("offsets and tips must be finite")
        return self


class Level(NamedTuple):
    """Joints of one depth of the tree; all parents are one level up."""

    joints: list[int]
    parents: list[int]
    offsets: Float[np.ndarray, "l 3 1"]  # metres


@dataclass(frozen=True)
class Skeleton:
    """A `SkeletonConfig` with the tables that forward kinematics derives from it."""

    config: SkeletonConfig

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""
        return self.config.names

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent of each joint, -1 for the root."""
        return self.config.parents

    @property
    def joints(self) -> int:
        """How many joints there are."""
        return len(self.config.names)

    @cached_property
    def offsets(self) -> Float[np.ndarray, "j 3"]:
        """Rest offset of each joint from its parent, metres."""
        return np.array(self.config.offsets, np.float32)

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """Joints below the root grouped by tree depth, for one batched product per level."""
        depth = [0] * self.joints
        for joint, parent in enumerate(self.parents[1:], start=1):
            depth[joint] = depth[parent] + 1
        groups = [[j for j in range(self.joints) if depth[j] == d] for d in range(1, max(depth) + 1)]
        return tuple(Level(g, [self.parents[j] for j in g], self.offsets[g, :, None]) for g in groups)

    @cached_property
    def feature_joints(self) -> tuple[int, ...]:
        """Joints in the order of the motion features: part by part, ascending within each part."""
        return tuple(joint for part in self.config.parts.values() for joint in part)

    @cached_property
    def rest_positions(self) -> Float[np.ndarray, "j 3"]:
        """World position of each joint in the rest pose, metres."""
        return summed(self.offsets, self.parents)

    def with_offsets(
        self, offsets: Iterable[Iterable[float]], tips: Mapping[str, Iterable[float]] | None = None
    ) -> "Skeleton":
        """The same joints at other rest offsets and, if they are given, with other tips (metres)."""
        update: dict[str, Any] = {"offsets": triples(offsets)}
        if tips is not None:
            update["tips"] = dict(zip(tips, triples(tips.values()), strict=True))
        return Skeleton(self.config.model_copy(update=update))

    def index(self, name: str) -> int:
        """Index of a joint by name; raises KeyError for an unknown name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no joint {name!r}; there are {', '.join(self.names[:6])}, ...") from None

    def indices(self, names: Sequence[str]) -> list[int]:
        """Indices of several joints by name."""
        return [self.index(name) for name in names]


def summed(offsets: Float[np.ndarray, "j 3"], parents: Sequence[int]) -> Float[np.ndarray, "j 3"]:
    """The place of each joint, by its offset from its parent (-1 for none); parents come first."""
    places = offsets.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            places[joint] += places[parent]
    return places


def triples(rows: Iterable[Iterable[float]]) -> tuple[tuple[float, float, float], ...]:
    """Rows of three numbers as a tuple of tuples of floats, as `SkeletonConfig` has them."""
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


_FINGERS: dict[str, dict[str, tuple[float, float, float]]] = {  # bone offsets of the left hand
    "Thumb": {"Metacarpal": (0.022, -0.012, 0.024), "Proximal": (0.034, -0.004, 0.026), "Distal": (0.026, 0.0, 0.018)},
    "Index": {"Proximal": (0.088, 0.002, 0.026), "Intermediate": (0.040, 0.0, 0.002), "Distal": (0.023, 0.0, 0.001)},
    "Middle": {"Proximal": (0.090, 0.004, 0.004), "Intermediate": (0.044, 0.0, 0.0), "Distal": (0.027, 0.0, 0.0)},
    "Ring": {"Proximal": (0.085, 0.002, -0.017), "Intermediate": (0.040, 0.0, -0.001), "Distal": (0.025, 0.0, 0.0)},
    "Little": {
        "Proximal": (0.077, -0.002, -0.037),
        "Intermediate": (0.030, 0.0, -0.002),
        "Distal": (0.019, 0.0, -0.001),
    },
}
_TIPS: dict[str, tuple[float, float, float]] = {  # ends of the chains, left side
    "head": (0.0, 0.185, 0.0),
    "leftThumbDistal": (0.024, 0.0, 0.014),
    "leftIndexDistal": (0.021, 0.0, 0.0),
    "leftMiddleDistal": (0.023, 0.0, 0.0),
    "leftRingDistal": (0.022, 0.0, 0.0),
    "leftLittleDistal": (0.018, 0.0, 0.0),
    "leftToes": (0.0, 0.0, 0.065),
}


class SkinWeights(NamedTuple):
    """The joints that move each vertex, each joint once, and their shares, which sum to 1."""

    joints: Int[np.ndarray, "v k"]
    shares: Float[np.ndarray, "v k"]

    def on(self, joints: Sequence[int]) -> Float[np.ndarray, " v"]:
        """The share of each vertex that follows these joints, 0 to 1."""
        return np.asarray((self.shares * np.isin(self.joints, joints)).sum(1))


def _humanoid() -> SkeletonConfig:
    """The project's rig: 52 bones of the VRM 1.0 humanoid set, T-pose, 1.70 m, Y up, facing +Z, left is +X."""
    rows: list[tuple[str, str | None, tuple[float, float, float]]] = [
        ("hips", None, (0.0, 0.950, 0.0)),
        ("spine", "hips", (0.0, 0.075, -0.005)),
        ("chest", "spine", (0.0, 0.115, -0.010)),
        ("upperChest", "chest", (0.0, 0.125, -0.005)),
        ("neck", "upperChest", (0.0, 0.165, -0.005)),
        ("head", "neck", (0.0, 0.095, 0.020)),
    ]
    for side, x in (("left", 1.0), ("right", -1.0)):
        rows += [
            (f"{side}Shoulder", "upperChest", (0.030 * x, 0.120, 0.005)),
            (f"{side}UpperArm", f"{side}Shoulder", (0.130 * x, 0.010, -0.010)),
            (f"{side}LowerArm", f"{side}UpperArm", (0.265 * x, 0.0, 0.0)),
            (f"{side}Hand", f"{side}LowerArm", (0.245 * x, 0.0, 0.0)),
        ]
        for finger, bones in _FINGERS.items():
            parent = f"{side}Hand"
            for bone, (dx, dy, dz) in bones.items():
                rows.append((f"{side}{finger}{bone}", parent, (dx * x, dy, dz)))
                parent = f"{side}{finger}{bone}"
    for side, x in (("left", 1.0), ("right", -1.0)):
        rows += [
            (f"{side}UpperLeg", "hips", (0.092 * x, -0.035, 0.0)),
            (f"{side}LowerLeg", f"{side}UpperLeg", (0.0, -0.410, 0.005)),
            (f"{side}Foot", f"{side}LowerLeg", (0.0, -0.420, -0.020)),
            (f"{side}Toes", f"{side}Foot", (0.0, -0.065, 0.130)),
        ]
    names = tuple(row[0] for row in rows)
    legs = [i for i, name in enumerate(names) if name.endswith(("Leg", "Foot", "Toes"))]
    hands = [i for i, name in enumerate(names) if any(digit in name for digit in _FINGERS)]
    lower = (0, *legs)
    return SkeletonConfig(
        names=names,
        parents=tuple(-1 if row[1] is None else names.index(row[1]) for row in rows),
        offsets=tuple(row[2] for row in rows),
        parts={
            "lower": lower,
            "upper": tuple(i for i in range(len(names)) if i not in lower and i not in hands),
            "hands": tuple(hands),
        },
        mirror=tuple(names.index(other_side(name)) for name in names),
        feet=tuple(names.index(n) for n in ("leftFoot", "leftToes", "rightFoot", "rightToes")),
        tips=_TIPS | {"right" + name[4:]: (-x, y, z) for name, (x, y, z) in _TIPS.items() if name.startswith("left")},
        vrm={name: i for i, name in enumerate(names)},
    )


def numbered(names: Iterable[str]) -> list[str]:
    """Unique names without control characters: long ones keep their end, repeated ones get a number."""
    found, again = dict[str, None](), Counter[str]()
    for written in names:
        new = name = _NO_NAME.sub("_", written)[-NAME_LETTERS:]
        while new in found:
            again[name] += 1
            new = f"{name}_{again[name] + 1}"
        found[new] = None
    return list(found)


def other_side(bone: str) -> str:
    """The same bone on the other side; the bone itself in the middle of the body."""
    for side, other in (("left", "right"), ("right", "left")):
        if bone.startswith(side):
            return other + bone.removeprefix(side)
    return bone


HUMANOID = Skeleton(_humanoid())
