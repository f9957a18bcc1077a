"""Another rig's features become ours: bones where they were, any cutting, hands kept off in its own way."""

import numpy as np
from scripts.synthetic_release import skeleton
from tests.golden import golden

from echoavatar.engine.pipeline.foreign_rig import RigAdapter
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import (
    HUMANOID,
    Motion,
    Skeleton,
    forward_kinematics,
    from_features,
    part_sizes,
    to_features,
)
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix, unit
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS
from echoavatar_lab.corpora.rehearsal.action_clips import clip as motion_of
from echoavatar_lab.reference.release_rig import AXES, CM, feature_order, rig_config, skeleton_config

C = np.array(AXES)


def source() -> Skeleton:
    names, parents, offsets = skeleton()
    return Skeleton(skeleton_config(names, parents, offsets, origin="test"))


def config(own: Skeleton):
    return rig_config(own.config, np.stack([np.eye(3)] * 88), np.stack([np.eye(3)] * 88))


def clip(own: Skeleton, rows: int, frames: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (their axes), root (cm), and their features; joints in the middle of a bone do not bend it."""
    random = np.random.default_rng(seed)
    turns = matrix_from_axis_angle(0.1 * random.standard_normal((rows, frames, 88, 3)))
    mapped = own.config.vrm.values()
    helpers = [joint for joint, name in enumerate(own.names) if "Part1" in name and joint not in mapped]
    turns[:, :, helpers] = np.eye(3, dtype=np.float32)
    root = np.array([0.0, -2.0, 95.0]) + random.standard_normal((rows, frames, 3)).cumsum(1)
    features = to_features(own, turns, root, previous_ground=root[:, 0, :2], up=2)
    return turns, root, features


def test_native_bones_are_where_they_were() -> None:
    own = source()
    turns, root, features = clip(own, 2, 8)
    plain = config(own).model_copy(update={"swing": None})
    adapter = RigAdapter(plain, own, "native")
    out = adapter.step(features, adapter.init_state(2), np.ones(2, np.bool_))
    moved = from_features(adapter.skeleton, out)
    np.testing.assert_allclose(moved.rotations, C @ turns @ C.T, atol=1e-5, rtol=0)
    wanted = (root - root[:, :1]) @ C.T * CM
    np.testing.assert_allclose(moved.root[..., [0, 2]], wanted[..., [0, 2]], atol=1e-5, rtol=0)
    assert out.shape[2] == sum(part_sizes(own).values())


def test_a_clip_gives_the_features_that_it_would_come_from() -> None:
    """Rotations and velocities are theirs to rounding; the height begins at the rest pose's, in centimetres."""
    own = source()
    turns, root, features = clip(own, 1, 8)
    rotations = quaternion_from_matrix(C @ turns[0] @ C.T)
    motion = Motion(own, rotations, (root[0] @ C.T * CM), 30.0)
    adapter = RigAdapter(config(own).model_copy(update={"swing": None}), own, "native")
    made, height = adapter.features_of(motion), travel_slice(own).stop - 1
    kept = [channel for channel in range(made.shape[1]) if channel != height]
    np.testing.assert_allclose(made[:, kept], features[0][:, kept], atol=1e-4, rtol=0)
    rest = own.offsets[0, 1] / CM
    np.testing.assert_allclose(made[:, height], rest + root[0, :, 2] - root[0, 0, 2], atol=1e-3, rtol=0)


def test_a_clip_carried_over_comes_back_pointing_the_same_way() -> None:
    """Our wave on their rig, as its features, and back on ours: limbs within a tenth of a degree."""
    own, waving = source(), motion_of(SCRIPTS["wave"])
    adapter = RigAdapter(config(own).model_copy(update={"swing": None}), own)
    features = adapter.features_of(retarget(waving, own, has_footing=False))
    out = adapter.step(features[None], adapter.init_state(1), np.ones(1, np.bool_))
    back = from_features(HUMANOID, out[0])
    theirs = forward_kinematics(HUMANOID, back.rotations, back.root).positions
    ours, bones = waving.pose().positions, HUMANOID.config.vrm
    for upper, lower in (("rightUpperArm", "rightLowerArm"), ("rightLowerArm", "rightHand"), ("neck", "head")):
        one, other = (place[:, bones[lower]] - place[:, bones[upper]] for place in (ours, theirs))
        assert (unit(one) * unit(other)).sum(-1).min() > np.cos(np.radians(0.1))


def test_on_the_humanoid_bones_point_the_same_way_and_the_root_travels_to_scale() -> None:
    own = source()
    turns, root, features = clip(own, 1, 8)
    adapter = RigAdapter(config(own).model_copy(update={"swing": None}), own)
    out = adapter.step(features, adapter.init_state(1), np.ones(1, np.bool_))
    moved = from_features(HUMANOID, out[0])
    ours = forward_kinematics(HUMANOID, moved.rotations, moved.root)
    theirs = forward_kinematics(own, C @ turns[0] @ C.T, root[0] @ C.T * CM)
    bones = [("leftUpperArm", "leftLowerArm"), ("rightLowerArm", "rightHand"), ("leftLowerLeg", "leftFoot")]
    for upper, lower in bones:
        pairs = [(ours, HUMANOID.config.vrm), (theirs, own.config.vrm)]
        one, other = (pose.positions[:, m[lower]] - pose.positions[:, m[upper]] for pose, m in pairs)
        assert (unit(one) * unit(other)).sum(-1).min() > 0.9999
    hips = [pose.positions[:, [m["leftUpperLeg"], m["rightUpperLeg"]]].mean(1) for pose, m in pairs]
    travel = [place[:, [0, 2]] - place[:1, [0, 2]] for place in hips]
    np.testing.assert_allclose(travel[0], travel[1], atol=1e-4, rtol=0)  # both rigs are as tall


def test_hands_are_kept_off_as_published_in_our_axes_and_metres() -> None:
    """The golden clip through features, our axes and back: the released result, centimetres and Z up."""
    stored = dict(np.load(golden("reference_release/ik.npz")))
    theirs = read_bvh(golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0).skeleton
    own = Skeleton(skeleton_config(theirs.names, theirs.parents, theirs.offsets, origin="bvh"))
    features = to_features(own, stored["R_in"], stored["trans_in"], up=2)
    rotations, _ = RigAdapter(config(own), own, "native").canonical(features[None])
    np.testing.assert_allclose(C.T @ rotations[0] @ C, stored["R_out"], atol=2e-5, rtol=0)
    moved = (np.abs(C.T @ rotations[0] @ C - stored["R_in"]) > 1e-4).any((-1, -2))
    arms = [own.index("Shoulder_R"), own.index("Shoulder_L")]
    assert [int(moved[:, shoulder].sum()) for shoulder in arms] == [18, 10]
    assert int(moved.sum()) == 28


def test_the_mean_of_the_published_statistics_is_somebody_who_stands() -> None:
    """Upright, on the floor, hands in front of the hips, facing +Z: order, axes, unit and height are theirs."""
    theirs = read_bvh(golden("reference_release/sample_60fps.bvh"), metres_per_unit=1.0).skeleton
    own = Skeleton(skeleton_config(theirs.names, theirs.parents, theirs.offsets, origin="bvh"))
    mean = np.load(golden("reference_release/body_norm.npz"))["mean"][feature_order(own)]
    adapter = RigAdapter(config(own), own)
    features = adapter.step(np.tile(mean, (1, 8, 1)), adapter.init_state(1), np.ones(1, np.bool_))
    moved = from_features(HUMANOID, features[0, -1:])
    places = forward_kinematics(HUMANOID, moved.rotations, moved.root).positions[0]
    at = {name: places[joint] - places[0] * np.array([1, 0, 1]) for name, joint in HUMANOID.config.vrm.items()}
    for side, sign in (("left", 1), ("right", -1)):
        assert 0.05 < at[f"{side}Foot"][1] < 0.15
        assert 0.8 < at[f"{side}Hand"][1] < 1.2
        assert 0.1 < at[f"{side}Hand"][2] < 0.4
        assert 0.1 < sign * at[f"{side}Hand"][0] < 0.5
        assert at[f"{side}Toes"][2] > at[f"{side}Foot"][2]
    assert at["head"][1] > 1.3
