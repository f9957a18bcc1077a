"""Motion features: layout, exact return, any cutting, statistics, and the reference release's own features."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests import golden as fixtures

from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics, from_features, part_sizes, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, matrix_to_6d


def random_clip(*shape: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    rotations = matrix_from_quaternion(generator.standard_normal((*shape, 52, 4)))
    return rotations, generator.standard_normal((*shape, 3))


def test_sizes_are_the_agreed_ones():
    assert part_sizes(HUMANOID) == {"lower": 57, "upper": 78, "hands": 180}
    assert to_features(HUMANOID, np.tile(np.eye(3), (1, 52, 1, 1)), np.zeros((1, 3))).shape == (1, 315)


def test_layout_is_six_numbers_per_joint_and_travel_after_the_lower_body():
    rotations, root = random_clip(5)
    features = to_features(HUMANOID, rotations, root)
    six = matrix_to_6d(rotations)
    lower, upper = HUMANOID.config.parts["lower"], HUMANOID.config.parts["upper"]
    assert features[3, 6:12].tolist() == six[3, lower[1]].tolist()
    assert features[3, 57 : 57 + 6].tolist() == six[3, upper[0]].tolist()
    assert features[0, 54:56].tolist() == [0, 0]
    np.testing.assert_allclose(features[3, 54:56], root[3, [0, 2]] - root[2, [0, 2]], atol=1e-5)
    assert features[3, 56] == root[3, 1]


def test_motion_comes_back():
    rotations, root = random_clip(2, 7)
    back = from_features(HUMANOID, to_features(HUMANOID, rotations, root))
    np.testing.assert_allclose(back.rotations, rotations, atol=1e-5)
    np.testing.assert_allclose(back.root + root[:, :1] * np.array([1, 0, 1]), root, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(1, 5), min_size=1, max_size=5))
def test_any_cutting_gives_the_whole(cuts):
    rotations, root = random_clip(sum(cuts))
    whole = to_features(HUMANOID, rotations, root)
    ground, start = None, 0
    for cut in cuts:
        piece = slice(start, start + cut)
        part = to_features(HUMANOID, rotations[piece], root[piece], previous_ground=ground)
        np.testing.assert_allclose(part, whole[piece], atol=1e-5)
        ground, start = root[piece][-1, [0, 2]], start + cut


def test_a_rig_without_parts_is_refused():
    bare = Skeleton(HUMANOID.config.model_copy(update={"parts": {}}))
    with pytest.raises(ValueError, match="no body parts"):
        part_sizes(bare)


@pytest.fixture(scope="module")
def reference():
    """The reference's sample in centimetres, its features, and a skeleton with its parts."""
    motion = read_bvh(fixtures.golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0)
    with (
        np.load(fixtures.golden("reference_release/bvh_features.npz")) as stored,
        np.load(fixtures.golden("reference_release/parts.npz")) as parts,
    ):
        golden = {key: stored[key] for key in stored.files}
        joints = {part: tuple(parts[f"{part}_joints"].tolist()) for part in ("lower", "upper", "hands")}
    skeleton = Skeleton(motion.skeleton.config.model_copy(update={"parts": joints}))
    return skeleton, motion, golden


def in_reference_order(skeleton, features):
    """All joints ascending, then travel."""
    out = np.empty_like(features)
    lower = len(skeleton.config.parts["lower"])
    six = np.concatenate([features[:, : 6 * lower], features[:, 6 * lower + 3 :]], -1)
    for place, joint in enumerate(skeleton.feature_joints):
        out[:, 6 * joint : 6 * joint + 6] = six[:, 6 * place : 6 * place + 6]
    out[:, -3:] = features[:, 6 * lower : 6 * lower + 3]
    return out


@pytest.mark.parametrize(("key", "stride"), [("feat60", 1), ("feat30", 2)])
def test_the_reference_features_of_its_sample(reference, key, stride):
    skeleton, motion, golden = reference
    rotations, root = motion.matrices()[::stride], motion.root[::stride]
    root = root + np.array([0, 0, skeleton.offsets[0, 2] - root[0, 2]])  # its heights start from the rest pose's
    features = to_features(skeleton, rotations, root, up=2)
    ours = in_reference_order(skeleton, features)
    np.testing.assert_allclose(ours[:, :-3], golden[key][:, :-3], atol=2e-5, rtol=0)
    np.testing.assert_allclose(ours[:, -3:], golden[key][:, -3:], atol=1e-4, rtol=0)


def test_the_reference_positions_of_its_sample(reference):
    """Its kinematics leave the root at its rest offset (paper, appendix); centimetres."""
    skeleton, motion, golden = reference
    pose = forward_kinematics(skeleton, motion.matrices(), np.broadcast_to(skeleton.offsets[0], (motion.frames, 3)))
    np.testing.assert_allclose(pose.positions, golden["fk_pos"], atol=1e-4, rtol=0)
