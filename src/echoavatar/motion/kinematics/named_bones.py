"""Which joint is which bone, by what the names say and the order of the tree.

A word alone decides little: a `leg` is the thigh in one rig and the shin in the next, a `shoulder` the clavicle or the
upper arm. So a limb is read as a whole: of all chains of joints from the trunk outward, the one whose names agree best
with the order thigh, shin, foot. Hips are where legs, arms and head meet; spine and neck lie on the way to the head.
"""

from collections.abc import Sequence

import numpy as np

from .joint_tree import REQUIRED, SIDES, Tree, head_above, trunk_bones
from .joint_words import DIGITS
from .skeleton import HUMANOID

_LEG, _ARM = ("UpperLeg", "LowerLeg", "Foot", "Toes"), ("Shoulder", "UpperArm", "LowerArm", "Hand")
_OPTIONAL = ("Shoulder", "Toes")
_MEANS = {  # how well a word names each bone of a limb
    "hips": {"UpperLeg": 2.0},
    "thigh": {"UpperLeg": 3.0},
    "leg": {"UpperLeg": 1.5, "LowerLeg": 1.5, "Foot": 0.75, "Toes": 0.5},
    "knee": {"LowerLeg": 3.0},
    "foot": {"Foot": 2.5, "Toes": 1.0},
    "ankle": {"Foot": 3.0},
    "toe": {"Toes": 3.0},
    "clavicle": {"Shoulder": 3.0},
    "shoulder": {"Shoulder": 2.0, "UpperArm": 2.0},
    "upperarm": {"UpperArm": 3.0},
    "arm": {"UpperArm": 2.0, "LowerArm": 1.5},
    "elbow": {"LowerArm": 3.0},
    "hand": {"Hand": 2.5},
    "wrist": {"Hand": 3.0},
}
_GAP, _BEGIN = 2.0, 0.5  # what a missing bone costs in the middle of a limb, and at its beginning
_STRANGE, _LEAST = 1.0, 0.25  # what an unknown word in a name costs; what a name is worth at least
_HEADS = {"head": 3.0, "face": 1.0}


def named_bones(tree: Tree) -> dict[str, int]:
    """VRM bone name to joint, of the most complete body in the tree."""
    bodies = [_body(tree, start) for start in _starts(tree)]
    return max(bodies, key=lambda bones: (sum(bone in bones for bone in REQUIRED), len(bones)), default={})


def finger_bones(side: str) -> dict[str, list[str]]:
    """The three bones of each digit of a hand."""
    digits = map(str.capitalize, DIGITS)
    return {digit: [name for name in HUMANOID.names if name.startswith(side + digit)] for digit in digits}


def _starts(tree: Tree) -> list[int]:
    """The lowest joints below which most bones of a body are named: one for each of several equal bodies."""
    claims: list[set[str]] = []
    for said in tree.said:
        bones = {said.side + bone for bone in _MEANS.get(said.part, ())} if said.side else set(_HEADS) & {said.part}
        claims.append(set() if said.is_helper else bones & set(REQUIRED))
    for joint in range(len(claims) - 1, -1, -1):
        if tree.parents[joint] >= 0:
            claims[tree.parents[joint]] |= claims[joint]
    most = max(map(len, claims), default=0)
    full = [joint for joint, claim in enumerate(claims) if len(claim) == most]
    return [joint for joint in full if not set(tree.children[joint]) & set(full)]


def _body(tree: Tree, start: int) -> dict[str, int]:
    below = tree.below(start)
    legs, arms = ([_limb(tree, below, side, limb) for side in SIDES] for limb in (_LEG, _ARM))
    arms = [_evened(tree, arm) for arm in arms]
    limbs = {side + bone: joint for two in (legs, arms) for side, limb in zip(SIDES, two, strict=True)
             for bone, joint in limb.items()}  # fmt: skip
    at_arms = tree.meet([next(iter(arm.values())) for arm in arms if arm]) if all(arms) else -1
    head = _head(tree, below)
    if head < 0 <= at_arms and (feet := [limbs[f"{side}Foot"] for side in SIDES if f"{side}Foot" in limbs]):
        up = tree.places[at_arms] - tree.places[feet].mean(0)
        head = head_above(tree, at_arms, list(limbs.values()), up / max(float(np.linalg.norm(up)), 1e-9))
    found = limbs | ({"head": head} if head >= 0 else {})
    hips = _hips(tree, start, tree.meet(list(found.values())), has_legs=all(legs))
    if hips >= 0:
        found |= {"hips": hips} | trunk_bones(tree, hips, at_arms, head)
    for side in SIDES:
        if f"{side}Hand" in found:
            found |= _fingers(tree, found[f"{side}Hand"], side)
    return found | (_face(tree, head) if head >= 0 else {})


def _limb(tree: Tree, joints: Sequence[int], side: str, bones: Sequence[str]) -> dict[str, int]:
    """The chain of joints, each above the next, whose names agree best with `bones`; of equals the first."""
    best: tuple[float, tuple[tuple[int, int], ...]] = (0.0, ())
    chains: dict[int, dict[int, tuple[float, tuple[tuple[int, int], ...]]]] = {}  # by last bone, down to each joint
    needed = [bone not in _OPTIONAL for bone in bones]
    for joint in joints:
        before, said = chains.get(tree.parents[joint], {}), tree.said[joint]
        chains[joint] = dict(before)
        if said.side != side or said.is_helper:
            continue
        for bone, worth in _MEANS.get(said.part, {}).items():
            if bone not in bones:
                continue
            slot = bones.index(bone)
            shorter = [(-_BEGIN * sum(needed[:slot]), ())] + [
                (score - _GAP * sum(needed[last + 1 : slot]), chain)
                for last, (score, chain) in before.items()
                if last < slot
            ]
            score, chain = max(shorter, key=lambda one: one[0])
            longer = score + max(worth - _STRANGE * len(said.strangers), _LEAST), (*chain, (slot, joint))
            if slot not in before or longer[0] > before[slot][0]:
                chains[joint][slot] = longer
            best = max(best, longer, key=lambda one: one[0])
    return {bones[slot]: joint for slot, joint in best[1]}


def _evened(tree: Tree, arm: dict[str, int]) -> dict[str, int]:
    """The arm; of joints that differ in a number alone (`Arm1`, `Arm2`, `Arm3`), the two with the most equal bones."""

    def name(joint: int) -> tuple[object, ...]:
        said = tree.said[joint]
        return said.side, *(word for word in said.plain if not word.isdecimal())

    above = tree.above(arm["Hand"])[:0:-1] if {"UpperArm", "LowerArm", "Hand"} <= {*arm} else []
    line = [joint for joint in above if name(joint) == name(arm["UpperArm"])]
    if len(line) < 3 or arm["LowerArm"] not in line:
        return arm
    upper, lower = tree.evenest(line, arm["Hand"])
    return ({"Shoulder": line[0]} if upper != line[0] else {}) | arm | {"UpperArm": upper, "LowerArm": lower}


def _head(tree: Tree, joints: Sequence[int]) -> int:
    """The topmost joint that says head; or the face, where it follows the neck."""
    worth = {}
    for joint in joints:
        said, parent = tree.said[joint], tree.parents[joint]
        is_head = said.part == "head" or (said.part == "face" and parent >= 0 and tree.said[parent].part == "neck")
        if is_head and not (said.side or said.is_helper):
            worth[joint] = _HEADS[said.part] - _STRANGE * len(said.strangers)
    return max(worth, key=worth.__getitem__, default=-1)


def _hips(tree: Tree, start: int, meet: int, *, has_legs: bool) -> int:
    """Where the limbs meet, or the nearest joint above that says hips; without limbs the first that says so."""
    line = tree.above(meet) if meet >= 0 else tree.below(start)
    saying = [joint for joint in line if tree.said[joint].part == "hips" and not tree.said[joint].side]
    return next((joint for joint in saying if not tree.said[joint].is_helper), meet if has_legs else -1)


def _fingers(tree: Tree, hand: int, side: str) -> dict[str, int]:
    """The digits below a hand; numbered fingers count from the thumb, or from the index where a thumb is named."""
    below = [j for j in tree.below(hand)[1:] if not tree.said[j].is_helper and tree.said[j].side in ("", side)]
    chains = {digit: _chain(tree, [j for j in below if tree.said[j].part == digit]) for digit in DIGITS}
    numbered = [j for j in below if tree.said[j].part == "finger" and tree.said[j].number >= 0]
    first = [j for j in numbered if not set(tree.above(j)[1:]) & set(numbered)]
    free = [digit for digit in DIGITS if not chains[digit]]
    for digit, joint in zip(free, sorted(first, key=lambda j: tree.said[j].number), strict=False):
        chains[digit] = _chain(tree, [j for j in tree.below(joint) if j in numbered])
    found: dict[str, int] = {}
    for digit, names in finger_bones(side).items():
        chain = chains[digit.lower()]
        if digit != "Thumb":
            chain = [joint for joint in chain if not tree.said[joint].is_metacarpal]
            numbers = [tree.said[joint].number for joint in chain[:2]]
            if len(chain) > 3 and (numbers[0] == 0 or numbers[0] == numbers[1] > 0):
                del chain[0]  # a joint 0, or a second joint 1, before 1, 2, 3 is a metacarpal
        found |= dict(zip(names, chain, strict=False))
    return found


def _chain(tree: Tree, joints: Sequence[int]) -> list[int]:
    """The longest line of these joints that hang from each other."""
    listed = set(joints)
    return max(([one for one in tree.above(joint)[::-1] if one in listed] for joint in joints), key=len, default=[])


def _face(tree: Tree, head: int) -> dict[str, int]:
    """Eyes and jaw."""
    found: dict[str, int] = {}
    for joint in tree.below(head):
        said = tree.said[joint]
        bone = {"eye": f"{said.side}Eye" if said.side else "", "jaw": "" if said.side else "jaw"}.get(said.part, "")
        if bone and not said.is_helper:
            found.setdefault(bone, joint)
    return found
