import numpy as np
import pytest
from pydantic import ValidationError

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.skeleton import numbered


def test_our_rig_has_the_agreed_shape():
    parts = HUMANOID.config.parts
    assert HUMANOID.joints == 52
    assert {name: len(joints) for name, joints in parts.items()} == {"lower": 9, "upper": 13, "hands": 30}
    assert sorted(HUMANOID.feature_joints) == list(range(52))


def test_our_rig_stands_on_the_floor_facing_ahead():
    rest = HUMANOID.rest_positions
    left_toes = rest[HUMANOID.index("leftToes")]
    assert 0 < float(rest[:, 1].min()) < 0.03
    assert float(left_toes[0]) > 0 < float(left_toes[2])


def test_mirroring_twice_is_nothing():
    pairs = HUMANOID.config.mirror
    assert [pairs[pairs[joint]] for joint in range(52)] == list(range(52))
    assert HUMANOID.names[pairs[HUMANOID.index("leftHand")]] == "rightHand"


def test_tips_end_the_chains():
    parents = set(HUMANOID.parents)
    ends = {HUMANOID.names[joint] for joint in range(52) if joint not in parents}
    assert set(HUMANOID.config.tips) == ends


def test_each_level_hangs_from_the_one_above():
    above, seen = [0], [0]
    for joints, parents, offsets in HUMANOID.levels:
        assert set(parents) <= set(above)
        assert [HUMANOID.parents[joint] for joint in joints] == parents
        np.testing.assert_array_equal(offsets[..., 0], HUMANOID.offsets[joints])
        above, seen = joints, [*seen, *joints]
    assert sorted(seen) == list(range(52))


@pytest.mark.parametrize(
    ("names", "parents", "complaint"),
    [
        (("a", "b"), (-1,), "differ"),
        (("a", "a"), (-1, 0), "unique"),
        (("a", "b"), (0, -1), "root"),
        (("a", "b", "c"), (-1, 2, 0), "after its parent"),
    ],
)
def test_a_skeleton_must_be_a_tree(names, parents, complaint):
    with pytest.raises(ValidationError, match=complaint):
        SkeletonConfig(names=names, parents=parents, offsets=((0, 0, 0),) * len(names))


def test_unknown_joint_is_named():
    with pytest.raises(KeyError, match="tail"):
        HUMANOID.index("tail")


def test_a_skeleton_comes_back_from_json():
    stored = HUMANOID.config.model_dump_json()
    assert Skeleton(SkeletonConfig.model_validate_json(stored)) == HUMANOID


@pytest.mark.parametrize(
    "change",
    [{"vrm": {"hips": 52}}, {"feet": (-1,)}, {"mirror": (99,)}, {"parts": {"lower": (52,)}}],
    ids=["vrm", "feet", "mirror", "parts"],
)
def test_a_skeleton_names_its_own_joints_alone(change):
    with pytest.raises(ValidationError, match="of 52"):
        SkeletonConfig.model_validate(HUMANOID.config.model_dump() | change)


def test_offsets_must_be_finite():
    offsets = ((0.0, float("nan"), 0.0), *HUMANOID.config.offsets[1:])
    with pytest.raises(ValidationError, match="finite"):
        SkeletonConfig.model_validate(HUMANOID.config.model_dump() | {"offsets": offsets})


def test_names_that_come_again_are_numbered():
    assert numbered(["a", "b", "a", "a_2", "a"]) == ["a", "b", "a_2", "a_2_2", "a_3"]
    names = numbered(["x"] * 30_000)
    assert len(set(names)) == len(names)
    assert numbered(["a\nb", "x" * 300 + "|Hips", "a\nb"]) == ["a_b", "x" * 235 + "|Hips", "a_b_2"]
