"""Which joint is which bone, by the shape of the tree alone: for rigs whose names are not understood.

A body at rest stands on two equal legs that meet at the hips. Above them two equal arms go to the sides, and a head
goes up between them. Feet point ahead, which tells left from right.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Float

from .joint_tree import SIDES, Tree, head_above, trunk_bones
from .named_bones import finger_bones

_Vector = Float[np.ndarray, "3"]
_UPS = np.array([(0, 1, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0), (1, 0, 0), (-1, 0, 0)], np.float64)
_LEG, _ARM = ("UpperLeg", "LowerLeg", "Foot", "Toes"), ("UpperArm", "LowerArm", "Hand", "Shoulder")
FLOOR = 0.1  # of the height: ankles are lower, knees and hands higher
HIP = 0.12  # of a leg, below its top: the thigh begins no lower, but its twist joints do
ALIKE = 0.2  # the most by which two legs or two arms differ in length
KNEE = 0.25  # of a limb: each of its two bones is longer
SIDEWAYS = 0.08  # of the height: arms go farther from the middle
COLLAR = 0.85  # of the next bone: a shoulder is shorter, an upper arm is not
INNER = 0.6  # of a thigh's distance from the middle: what begins nearer is a shoulder, whatever twist joints follow
REACH = 0.65  # of the way to the tip of an arm: a hand without fingers begins no nearer, but twist joints do
KNUCKLE = 0.45  # of the way from wrist to the second joint of a finger: a metacarpal begins nearer
THUMB = 0.75  # of the usual way from wrist to finger: a thumb begins nearer
FEET, KNEES = 0.05, 0.01  # of the height, both together: less says nothing about the front


def shaped_bones(tree: Tree) -> dict[str, int]:
    """VRM bone name to joint; empty where no part of the tree has the shape of a body that stands."""
    if not np.isfinite(tree.places).all():
        return {}
    roots = [joint for joint, parent in enumerate(tree.parents) if parent < 0]
    ways_up = [_Body(tree, up) for up in _UPS]
    return max((body.bones(root) for root in roots for body in ways_up), key=len, default={})


class _Body:
    """Looks for a body that stands along one axis."""

    def __init__(self, tree: Tree, up: _Vector) -> None:
        self.tree, self.up, self.places = tree, up, np.asarray(tree.places, np.float64)
        self.high = self.places @ up
        self.lowest = np.array(
            [np.inf if said.is_helper else high for said, high in zip(tree.said, self.high, strict=True)]
        )
        for joint in range(len(tree.parents) - 1, 0, -1):  # the lowest of each joint's descendants
            if (parent := tree.parents[joint]) >= 0:
                self.lowest[parent] = min(self.lowest[parent], self.lowest[joint])

    def bones(self, root: int) -> dict[str, int]:
        """All bones below a root; empty where one that must be there is not."""
        body = self._below(root)
        self.low, self.tall = float(self.high[body].min()), float(np.ptp(self.high[body]))
        if self.tall <= 0:
            return {}
        return max((self._on(joint) for joint in self.tree.below(root)), key=len)

    def _on(self, node: int) -> dict[str, int]:
        """The bones of a body whose legs meet at a joint."""
        floor = self.low + FLOOR * self.tall
        ways = [child for child in self.tree.children[node] if self.lowest[child] < floor]
        legs = self._alike([leg for way in ways if (leg := self._leg(way))]) if len(ways) > 1 else []
        if not legs:
            return {}
        standing = {joint for leg in legs for joint in self.tree.below(leg[0])}
        tops = self.high[legs[0][0]] + FLOOR * self.tall
        while node >= 0 and not any(self.high[j] > tops for j in self._below(node) if j not in standing):
            node = self.tree.parents[node]  # the legs meet at a joint below the hips
        return self._upper(node, [j for j in self._below(node) if j not in standing], legs) if node >= 0 else {}

    def _upper(self, hips: int, trunk: list[int], legs: list[list[int]]) -> dict[str, int]:
        tree, across = self.tree, self._level(self.places[legs[0][0]] - self.places[legs[1][0]])
        aside = (self.places - self.places[hips]) @ across / max(float(np.linalg.norm(across)), 1e-9)
        ends = [max(trunk, key=aside.__getitem__), min(trunk, key=aside.__getitem__)]
        at_arms = tree.meet(ends)
        if at_arms in (-1, hips, *ends) or min(aside[ends[0]], -aside[ends[1]]) < SIDEWAYS * self.tall:
            return {}
        ways = [(tree.between(at_arms, end) or [end])[0] for end in ends]
        inner = INNER * min(abs(aside[leg[0]]) for leg in legs)
        arms = self._alike([self._arm(way, is_inner=abs(aside[way]) < inner) for way in ways])
        head = head_above(tree, at_arms, ends, self.up)
        if not arms or head < 0 or self.high[head] < self.high[at_arms]:
            return {}
        left, right = self._sides(legs, across)
        found = {"hips": hips, "head": head} | trunk_bones(tree, hips, at_arms, head)
        for side, leg, arm in ((left, legs[0], arms[0]), (right, legs[1], arms[1])):
            limbs = *zip(_LEG, leg, strict=False), *zip(_ARM, arm, strict=False)
            found |= {side + bone: joint for bone, joint in limbs}
            found |= self._fingers(arm[2], side)
        return found

    def _below(self, joint: int) -> list[int]:
        return [one for one in self.tree.below(joint) if not self.tree.said[one].is_helper] or [joint]

    def _level(self, vector: _Vector) -> _Vector:
        level: _Vector = vector - self.up * (vector @ self.up)
        return level

    def _long(self, *joints: int) -> float:
        """Length of the line through some joints."""
        return float(np.linalg.norm(np.diff(self.places[list(joints)], axis=0), axis=1).sum())

    def _alike(self, limbs: list[list[int]]) -> list[list[int]]:
        """The two limbs that are most alike, in their order; none where no two are."""
        lengths = [self._long(*limb[:3]) for limb in limbs]
        pairs = [pair for pair in combinations(range(len(limbs)), 2) if all(lengths[k] > 0 for k in pair)]
        unlike = {pair: abs(np.log(lengths[pair[0]] / lengths[pair[1]])) for pair in pairs}
        best = min(unlike, key=unlike.__getitem__, default=None)
        return [limbs[k] for k in best] if best and unlike[best] < ALIKE else []

    def _leg(self, way: int) -> list[int]:
        """Thigh, shin, foot and where there are any toes; empty for what is no leg."""
        high = self.high
        line = self.tree.above(min(self._below(way), key=high.__getitem__))
        line = line[: line.index(way) + 1][::-1]
        foot = next(joint for joint in line if high[joint] < self.low + FLOOR * self.tall)
        upper = line[: line.index(foot)]
        thighs = [joint for joint in upper if high[joint] >= high[way] - HIP * (high[way] - high[foot])]
        shins = upper[len(thighs) :]
        if not shins:
            return []
        middle = (high[thighs[-1]] + high[foot]) / 2
        leg = [thighs[-1], min(shins, key=lambda joint: abs(high[joint] - middle)), foot]
        whole = self._long(*leg)
        if min(self._long(*leg[:2]), self._long(*leg[1:])) < KNEE * whole:
            return []
        far = {
            toe: float(np.linalg.norm(self._level(self.places[toe] - self.places[foot]))) for toe in self._ways(foot)
        }
        return leg + sorted(far, key=far.__getitem__)[-1:]

    def _arm(self, way: int, *, is_inner: bool) -> list[int]:
        """Upper arm, lower arm, hand, and where there is one the shoulder; empty for what is no arm."""
        tree = self.tree
        reach = {way: 0.0}
        for joint in tree.below(way)[1:]:
            reach[joint] = reach[tree.parents[joint]] + self._long(joint, tree.parents[joint])
        line = tree.above(max(self._below(way), key=reach.__getitem__))
        line = line[: line.index(way) + 1][::-1]
        hand = next((joint for joint in line[2:] if len(self._digits(joint)) > 2), -1)
        is_short = len(line) > 3 and (is_inner or self._long(*line[:2]) < COLLAR * self._long(*line[1:3]))
        shoulder = line[:1] if is_short else []
        line = line[len(shoulder) :]
        if hand < 0:  # no fork of fingers
            hand = line[2] if len(line) > 2 and self._long(*line[:3]) > REACH * self._long(*line) else line[-1]
        line = line[: line.index(hand) + 1]
        arm = tree.evenest(line[:-1], line[-1])  # twist joints are nearer to each other
        return [*arm, line[-1], *([way] if arm[0] != way else [])] if arm else []

    def _ways(self, joint: int) -> list[int]:
        return [child for child in self.tree.children[joint] if not self.tree.said[child].is_helper]

    def _sides(self, legs: list[list[int]], across: _Vector) -> tuple[str, str]:
        """The side of the first leg and of the second. `across` points from the second to the first."""
        feet = [self._level(self.places[leg[3]] - self.places[leg[2]]) for leg in legs if len(leg) > 3]
        knees = [self._level(self.places[leg[1]] - self.places[[leg[0], leg[2]]].mean(0)) for leg in legs]
        usual = np.array([0.0, 0.0, 1.0]) if self.up[1] else np.array([0.0, -1.0, 0.0])
        ways = [(np.sum(feet, 0) if feet else np.zeros(3), FEET), (np.sum(knees, 0), KNEES), (usual, 0.0)]
        ahead = next(way for way, least in ways if np.linalg.norm(way) > least * self.tall)
        return SIDES if across @ np.cross(self.up, ahead) > 0 else SIDES[::-1]

    def _fingers(self, hand: int, side: str) -> dict[str, int]:
        """Four or five digits: the thumb goes another way than the others, which lie in order beside it."""
        chains = self._digits(hand)
        chains = chains if len(chains) <= 5 else [chain for chain in chains if len(chain) > 2]  # without what it holds
        if not 4 <= len(chains) <= 5:
            return {}
        near = [self._long(hand, chain[0]) for chain in chains]
        ways = np.array([self.places[chain[1]] - self.places[chain[0]] for chain in chains])
        ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
        is_near = min(near) < THUMB * float(np.median(near))
        thumb = chains[int(np.argmin(near if is_near else (ways @ ways.T).sum(1)))]
        others = [chain for chain in chains if chain is not thumb]
        for chain in others:
            if len(chain) > 3 and self._long(hand, chain[0]) < KNUCKLE * self._long(hand, chain[1]):
                del chain[0]  # a metacarpal
        knuckles = self.places[[chain[0] for chain in others]]
        row = np.linalg.svd(knuckles - knuckles.mean(0))[2][0]
        row *= np.sign((self.places[thumb[0]] - knuckles.mean(0)) @ row)
        others.sort(key=lambda chain: -float(self.places[chain[0]] @ row))
        found: dict[str, int] = {}
        for names, chain in zip(finger_bones(side).values(), [thumb, *others], strict=False):
            found |= dict(zip(names, chain, strict=False))
        return found

    def _digits(self, joint: int) -> list[list[int]]:
        return [chain for way in self._ways(joint) if len(chain := self._chain(way)) > 1]

    def _chain(self, joint: int) -> list[int]:
        chain = [joint]
        while below := self._ways(chain[-1]):
            chain.append(below[0])
        return chain
