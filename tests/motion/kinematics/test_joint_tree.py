"""The joints of a file as a tree."""

import numpy as np
import pytest

from echoavatar.motion.kinematics.joint_tree import Tree, head_above, trunk_bones


def test_the_trunk_lies_between_hips_and_head():
    """However many joints it has: the first is the spine, the last carries the arms."""
    for count, bones in ((1, ["spine"]), (2, ["spine", "chest"]), (3, ["spine", "chest", "upperChest"])):
        names = ["hips", *(f"s{k}" for k in range(count)), "neck", "neck2", "head"]
        tree = Tree(names, list(range(-1, len(names) - 1)), np.zeros((len(names), 3)))
        found = trunk_bones(tree, 0, count, len(names) - 1)
        assert found == {"neck": count + 1} | {bone: 1 + k for k, bone in enumerate(bones)}
    names = ["hips", *(f"s{k}" for k in range(5)), "head"]
    tree = Tree(names, list(range(-1, 6)), np.zeros((7, 3)))
    assert trunk_bones(tree, 0, 5, 6) == {"spine": 1, "chest": 3, "upperChest": 5}


@pytest.mark.parametrize(
    ("line", "head"),
    [
        ([0.1, 0.1], 2),  # neck, head
        ([0.1, 0.1, 0.2], 2),  # the end of the head
        ([0.1, 0.05, 0.05], 3),  # two joints of the neck
        ([0.2], 1),  # no neck
    ],
)
def test_the_head_is_found_above_the_arms(line, head):
    places = np.array(
        [[0, 1.3, 0], *([0, 1.3 + sum(line[: k + 1]), 0] for k in range(len(line))), [0.2, 1.3, 0], [0, 0, 0]]
    )
    count = len(line)
    tree = Tree([f"b{k}" for k in range(count + 3)], [-1, *range(count), 0, -1], places)
    assert head_above(tree, 0, [count + 1], np.array([0.0, 1.0, 0.0])) == head


def test_joints_meet_where_both_hang_from():
    tree = Tree(["a", "b", "c", "d", "e"], [-1, 0, 1, 1, -1], np.zeros((5, 3)))
    assert (tree.meet([2, 3]), tree.meet([2, 1]), tree.meet([2, 4]), tree.meet([])) == (1, 1, -1, -1)
    assert tree.between(0, 2) == [1]
    assert tree.below(0) == [0, 1, 2, 3]
