"""The rig in our axes: parts, bones, feet, and the arithmetic of Unity's rotations."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scripts.synthetic_release import skeleton
from tests import golden as fixtures

from echoavatar.errors import CheckpointError
from echoavatar.motion.kinematics import HUMANOID, Skeleton, part_sizes
from echoavatar_lab.reference.release_rig import (
    body_statistics,
    bones_by_name,
    feature_order,
    rig_config,
    skeleton_config,
)

GOLDEN = Path(__file__).parents[3] / "../shared/golden/reference_release/parts.npz"


def config():
    names, parents, offsets = skeleton()
    return skeleton_config(names, parents, offsets, origin="test")


def test_parts_have_the_published_sizes_and_joints():
    rig = Skeleton(config())
    assert part_sizes(rig) == {"lower": 117, "upper": 162, "hands": 252}
    assert len(bones_by_name()) == 52 == len(rig.config.vrm)
    if GOLDEN.exists():
        stored = np.load(GOLDEN)
        for part, joints in rig.config.parts.items():
            assert list(joints) == stored[f"{part}_joints"].tolist()


def test_it_stands_upright_in_metres_with_its_left_at_x():
    rig = Skeleton(config())
    np.testing.assert_allclose(
        rig.rest_positions[rig.index("Wrist_L")], HUMANOID.rest_positions[HUMANOID.index("leftHand")], atol=1e-5
    )
    assert rig.names[rig.config.mirror[rig.index("Wrist_L")]] == "Wrist_R"
    assert rig.names[rig.config.mirror[rig.index("L_eye_jnt")]] == "R_eye_jnt"
    assert rig.config.mirror[rig.index("Neck_M")] == rig.index("Neck_M")
    assert [rig.names[joint] for joint in rig.config.feet] == ["Ankle_L", "Toes_L", "Ankle_R", "Toes_R"]


def test_unity_matrices_are_transform_times_inverse_rest():
    flip = np.diag([-1.0, 1.0, 1.0])
    rest = np.stack([np.linalg.qr(np.random.default_rng(k).standard_normal((3, 3)))[0] for k in range(88)])
    rig = rig_config(config(), rest, np.broadcast_to(flip, rest.shape))
    np.testing.assert_allclose(np.array(rig.unity[5]), flip @ rest[5].T, atol=1e-12)
    assert rig.swing.profile[0] == (-0.8, 0.22)


def test_another_rig_is_refused():
    names, parents, offsets = skeleton()
    with pytest.raises(CheckpointError, match=r"test is not the rig of the release: it lacks Wrist_L"):
        skeleton_config([n.replace("Wrist_L", "Hand_L") for n in names], parents, offsets, origin="test")
    with pytest.raises(CheckpointError, match="87 joints, not 88"):
        skeleton_config(names[:-1], parents[:-1], offsets[:-1], origin="test")


def rig() -> Skeleton:
    names, parents, offsets = skeleton()
    return Skeleton(skeleton_config(names, parents, offsets, origin="test"))


def test_the_order_is_that_of_the_published_parts():
    stored = np.load(fixtures.golden("reference_release/parts.npz"))
    wanted = [*stored["lower_feat"], *stored["upper_feat"], *stored["hands_feat"]]
    assert feature_order(rig()) == wanted


def test_154_published_deviations_are_held_and_features_come_back():
    stored = np.load(fixtures.golden("reference_release/body_norm.npz"))
    statistics = body_statistics(rig(), np.stack([stored["mean"], stored["std"]]))
    order = feature_order(rig())
    held = sorted(order[i] for i in range(531) if not statistics.varies[i])
    assert held == sorted([*stored["std_zero_dims"], *stored["std_tiny_dims"]])
    assert len(held) == 154
    features = torch.from_numpy(stored["feat30"])[:, order]
    normal = statistics.normalize(features)
    assert normal.abs().max() < 1000  # divided by the published deviations it is millions
    theirs = torch.from_numpy(stored["std"] * 0 + stored["mean"])[order]
    back = statistics.denormalize(normal)
    torch.testing.assert_close(back[:, statistics.varies], features[:, statistics.varies], atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(back[:, ~statistics.varies], theirs[~statistics.varies].expand(12, -1))


def test_channels_without_deviation_decode_to_their_mean():
    rows = np.stack([np.arange(531.0), np.where(np.arange(531) % 2, 0.5, 3e-5)])
    statistics = body_statistics(rig(), rows)
    back = statistics.denormalize(torch.full((1, 531), 1e6))
    order = torch.tensor(feature_order(rig()))
    assert torch.equal(back[0, ~statistics.varies], order[~statistics.varies].float())
