"""Statistics in the order of our features, and what hardly varies held still."""

import numpy as np
import torch
from scripts.synthetic_release import skeleton
from tests import golden as fixtures

from echoavatar.motion.kinematics import Skeleton
from echoavatar_lab.reference.release_rig import skeleton_config
from echoavatar_lab.reference.statistics import body_statistics, feature_order


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
