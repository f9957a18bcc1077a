"""The joints of a file as a tree, and the bones of trunk and head, found from where its limbs meet."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float

from .joint_words import Said, read_names

SIDES = ("left", "right")
REQUIRED = ("hips", "head") + tuple(
    f"{side}{bone}" for side in SIDES for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
)
UPRIGHT = 0.7  # cosine; the head goes up from the neck, a jaw or the brim of a hat does not
MOST = 12  # joints of an arm that are looked at
END = 0.09  # of the height at which the arms meet: a last joint farther than this above its parent is the head's end


def with_parents(joints: Iterable[int], parents: Sequence[int] | Mapping[int, int]) -> set[int]:
    """The joints and all their ancestors."""
    found = set[int]()
    for joint in joints:
        while joint >= 0 and joint not in found:
            found.add(joint)
            joint = parents[joint]
    return found


@dataclass(frozen=True)
class Tree:
    """The joints of a file, parents before children. A file may have several roots."""

    names: Sequence[str]
    parents: Sequence[int]  # -1 for a root
    places: Float[np.ndarray, "j 3"]  # at rest, any unit

    @cached_property
    def said(self) -> list[Said]:
        """What each name says."""
        return read_names(self.names)

    @cached_property
    def children(self) -> list[list[int]]:
        """The children of each joint."""
        found: list[list[int]] = [[] for _ in self.parents]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                found[parent].append(joint)
        return found

    def above(self, joint: int) -> list[int]:
        """The joint and its ancestors, upward."""
        line = []
        while joint >= 0:
            line.append(joint)
            joint = self.parents[joint]
        return line

    def below(self, joint: int) -> list[int]:
        """The joint and its descendants, parents first."""
        found = [joint]
        for one in found:
            found += self.children[one]
        return found

    def meet(self, joints: Sequence[int]) -> int:
        """The lowest common ancestor of these joints, which may be one of them; -1 for none."""
        lines = [self.above(joint) for joint in joints]
        return next((joint for joint in (lines[0] if lines else []) if all(joint in line for line in lines)), -1)

    def bearing(self) -> list[int]:
        """The joints without pivots and groups, which have one child, stand in its place and repeat its name.

        A group may also stand in its parent's place. If its name says no part of the body, it need not repeat the name.
        """
        near = 1e-3 * float(np.ptp(self.places, axis=0).max())
        held = list(range(len(self.names)))  # the joint that each pivot or group stands for, or the joint itself
        for joint in reversed(held[:]):
            parent = self.parents[joint]
            if len(self.children[joint]) == 1:
                one = held[self.children[joint][0]]
                is_here, is_above = np.linalg.norm(self.places[[one, parent]] - self.places[joint], axis=1) < near
                is_above = parent < 0 or (is_above and self.names[joint] not in self.names[parent])
                is_named = self.names[one] in self.names[joint] and (is_here or is_above)
                if is_named or (is_here and self.children[one] and not self.said[joint].part):
                    held[joint] = one
        return [joint for joint, one in enumerate(held) if one == joint]

    def only(self, joints: Sequence[int]) -> "Tree":
        """The tree of these joints alone; the parent of each is its nearest ancestor among them."""
        at = {joint: k for k, joint in enumerate(joints)}
        above = [next((at[one] for one in self.above(joint)[1:] if one in at), -1) for joint in joints]
        return Tree([self.names[joint] for joint in joints], above, self.places[list(joints)])

    def evenest(self, line: Sequence[int], end: int) -> tuple[int, ...]:
        """The two joints of a line whose bones up to `end` are longest and most equal; () for fewer than two."""

        def evenness(pair: tuple[int, ...]) -> float:
            upper, lower = np.linalg.norm(np.diff(self.places[[*pair, end]], axis=0), axis=1)
            return float(min(upper, lower) - abs(upper - lower) / 10)

        return max(combinations(line[:MOST], 2), key=evenness, default=())

    def between(self, top: int, joint: int) -> list[int]:
        """The joints on the way from `top` to `joint`, both left out."""
        line = self.above(joint)
        return line[1 : line.index(top)][::-1] if top in line else []


def trunk_bones(tree: Tree, hips: int, arms: int, head: int) -> dict[str, int]:
    """Spine, chest, upper chest and neck on the way from hips to head.

    Args:
        tree: the joints.
        hips: a joint.
        arms: where the arms meet; -1 if that is not known.
        head: a joint; -1 if it is not known.
    """
    way = tree.between(hips, head) or [joint for joint in tree.above(arms)[::-1] if hips in tree.above(joint)[1:]]
    plain = [joint for joint in way if not tree.said[joint].is_helper]
    necks = [joint for joint in (*plain, *way) if tree.said[joint].part == "neck"]
    necks = necks or [joint for joint in plain if arms in tree.above(joint)[1:]]
    spines = [joint for joint in plain if not necks or joint in way[: way.index(necks[0])]]
    found = {"neck": necks[0]} if necks else {}
    if len(spines) < 3:
        return found | dict(zip(("spine", "chest"), spines, strict=False))
    return found | {"spine": spines[0], "chest": spines[(len(spines) - 1) // 2], "upperChest": spines[-1]}


def head_above(tree: Tree, arms: int, beside: Sequence[int], up: Float[np.ndarray, "3"]) -> int:
    """The head by its place: the end of the chain that goes up where the arms meet; -1 for none.

    Args:
        tree: the joints.
        arms: where the arms meet.
        beside: joints of the arms.
        up: the direction from feet to hips.
    """
    taken = {joint for one in beside for joint in tree.above(one)}
    high = tree.places @ up
    starts = [joint for joint in _plain(tree, arms) if joint not in taken]
    chain = [max(starts, key=lambda joint: high[tree.below(joint)].max())] if starts else []
    while chain and len(below := _plain(tree, chain[-1])) == 1:
        chain += below
    if len(chain) > 1 and not tree.children[chain[-1]]:
        last = tree.places[chain[-1]] - tree.places[chain[-2]]
        long = float(np.linalg.norm(last))
        if last @ up < UPRIGHT * long or (len(chain) > 2 and long > END * (high[arms] - high.min())):
            chain.pop()
    return chain[-1] if chain and (len(chain) > 1 or tree.said[chain[0]].part != "neck") else -1


def _plain(tree: Tree, joint: int) -> list[int]:
    """Children of a joint that are no helpers and belong to neither side."""
    return [child for child in tree.children[joint] if not (tree.said[child].side or tree.said[child].is_helper)]
