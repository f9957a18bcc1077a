"""Which bones of the VRM humanoid set the joints of a rig are.

A VRM map in the file is believed. Without one, joints are found by their names (`named_bones`), and what names leave
open by the shape of the body (`shaped_bones`), unless it contradicts them. A map by the user comes before all.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from echoavatar.errors import MotionError

from .joint_tree import REQUIRED, SIDES, Tree
from .named_bones import named_bones
from .shaped_bones import shaped_bones
from .skeleton import HUMANOID, Skeleton, other_side, summed

BONES = (*HUMANOID.names, "leftEye", "rightEye", "jaw")
CHANCE = 4  # fewer names than these may be words of another language that look like ours
JointMap = Mapping[str, str | None]  # bone to joint by the user; None for a bone that the rig does not have


class UnknownRigError(MotionError):
    """Bones that motion needs are not found; `found` has the joint names of the others by bone."""

    def __init__(self, message: str, found: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.found = found or {}


def bone_map(skeleton: Skeleton) -> dict[str, int]:
    """VRM bone name to joint index.

    Raises UnknownRigError if the rig has no VRM map, and bones that motion needs are not found among its joints.
    """
    found = known_bones(skeleton)
    if not skeleton.config.vrm:
        check_bones(skeleton.names, found)
    return found


def known_bones(skeleton: Skeleton) -> dict[str, int]:
    """VRM bone name to joint index, for the bones that are found."""
    config = skeleton.config
    return dict(config.vrm or _read(config.names, config.parents, config.offsets))


def with_bones(skeleton: Skeleton, given: JointMap) -> Skeleton:
    """The skeleton with a VRM map: the user's, and what is found of the rest.

    Raises MotionError if the map names a joint that is not there, or bones that motion needs are still missing.
    """
    config = skeleton.config
    found = find_bones(_tree(config.names, config.parents, config.offsets), given)
    tipped = {joint for joint, name in enumerate(config.names) if name in config.tips}
    ends = {f"{side}Hand": -1 for side in SIDES if found.get(f"{side}LowerArm") in tipped}  # `with_wrists`
    check_bones(skeleton.names, ends | found)
    return Skeleton(config.model_copy(update={"vrm": found}))


def find_bones(tree: Tree, given: JointMap | None = None, believed: Mapping[str, int] | None = None) -> dict[str, int]:
    """VRM bone name to joint, for the bones that are found.

    Args:
        tree: the joints.
        given: the user's map, which comes before all else.
        believed: the map in the file; names and shape count where it lacks bones that motion needs.

    Raises:
        MotionError: the user's map names a joint that is not there.
    """
    joints = {bone: joint for bone, joint in (given or {}).items() if joint is not None}
    for bone, joint in joints.items():
        if joint not in tree.names:
            raise MotionError(f"the map says that {bone} is {joint[:80]!r}, and the rig has no such joint; correct it")
    own = {bone: list(tree.names).index(joint) for bone, joint in joints.items()}
    found, sure = {}, dict(believed or {})
    if any(bone not in sure for bone in REQUIRED):
        joints_of = tree.bearing()
        found = named_bones(plain := tree.only(joints_of))
        if any(bone not in found for bone in REQUIRED):
            found = _with_shape(plain, found)
        found = {bone: joints_of[joint] for bone, joint in found.items()}
    found = {bone: joint for bone, joint in found.items() if joint not in sure.values()} | sure
    return {bone: j for bone, j in found.items() if bone not in (given or {}) and j not in own.values()} | own


def _with_shape(tree: Tree, named: dict[str, int]) -> dict[str, int]:
    """The named bones and those that the shape tells, unless it contradicts the names. Names decide left and right."""
    shaped = shaped_bones(tree)
    said = [(bone, tree.said[joint].side) for bone, joint in shaped.items() if tree.said[joint].side]
    if 2 * sum(bone.startswith(side) for bone, side in said) < len(said):
        shaped = {other_side(bone): joint for bone, joint in shaped.items()}
    sure = {bone: joint for bone, joint in named.items() if bone in REQUIRED}
    if len(sure) < CHANCE and shaped:
        return shaped
    if not shaped or any(shaped.get(bone) != joint for bone, joint in sure.items()):
        return named
    return {bone: joint for bone, joint in shaped.items() if joint not in named.values()} | named


def check_bones(names: Sequence[str], found: Mapping[str, int]) -> None:
    """Raises UnknownRigError if bones that motion needs are missing; it lists them, and what was found."""
    missing = [bone for bone in REQUIRED if bone not in found]
    if not missing:
        return
    known = [f"{bone} ({names[found[bone]]})" for bone in REQUIRED if bone in found]
    left = [name for joint, name in enumerate(names) if joint not in found.values()]
    raise UnknownRigError(
        f"the rig is not known: no joint is {_some(missing, 6)}; found: {_some(known, 3) or 'nothing'}; not placed:"
        f" {_some(left, 6) or 'nothing'}. Say which joint is which with --map FILE; `echoavatar rig RIG --template -o"
        " FILE` begins that file",
        {bone: names[joint] for bone, joint in found.items()},
    )


def _some(words: Sequence[str], most: int) -> str:
    """The first few words, each of few letters, and how many more there are."""
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(word[:60] for word in words[:most]) + more


@lru_cache(maxsize=64)
def _read(
    names: tuple[str, ...], parents: tuple[int, ...], offsets: tuple[tuple[float, float, float], ...]
) -> dict[str, int]:
    return find_bones(_tree(names, parents, offsets))


def _tree(names: Sequence[str], parents: Sequence[int], offsets: Sequence[tuple[float, float, float]]) -> Tree:
    return Tree(names, parents, summed(np.array(offsets, np.float64), parents))


def feet_of(bones: Mapping[str, int]) -> list[int]:
    """Joints of left foot and toes, then of the right; the foot again where there are no toes."""
    return [bones.get(f"{s}{part}", bones[f"{s}Foot"]) for s in SIDES for part in ("Foot", "Toes")]
