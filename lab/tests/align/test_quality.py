"""The quality reward: a score in (0, 1) of the whole clip, kept whole on disk."""

import pytest
import torch
from lab.tests.align.moving_bodies import dips, reference_statistics, scene

from echoavatar.errors import CheckpointError
from echoavatar.motion.kinematics import FeatureStatistics
from echoavatar_lab.align.quality import PACE, QualityConfig, QualityReward, _with_differences


def model() -> QualityReward:
    torch.manual_seed(0)
    return QualityReward(QualityConfig(width=16, heads=2)).eval()


def test_a_score_depends_on_every_frame():
    x = torch.randn(1, 16, 315, requires_grad=True)
    score = model()(x)
    assert 0 < score.item() < 1
    score.sum().backward()
    assert (x.grad.abs().sum((0, 2)) > 0).all()


def test_features_are_normalised_as_the_tokenizer_does():
    one, other, x = model(), model(), torch.randn(2, 16, 315)
    other.set_statistics(
        FeatureStatistics(torch.full((315,), 2.0), torch.full((315,), 3.0), torch.ones(315, dtype=torch.bool))
    )
    torch.testing.assert_close(other(3 * x + 2), one(x))


def test_files(tmp_path):
    one, x = model(), torch.randn(2, 16, 315)
    one.save(tmp_path / "q", {})
    torch.testing.assert_close(QualityReward.load(tmp_path / "q")(x), one(x))
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        QualityReward.load(tmp_path / "none")


def test_as_a_reward_function():
    assert 0 < model().judge(scene(dips(())), reference_statistics()) < 1


def test_a_jolt_is_seen_in_the_differences():
    """A steady rise: one value, one pace, and a single jolt where it begins."""
    x = torch.arange(8.0)[None, :, None]
    found = _with_differences(x)[0]
    assert found[:, 1].tolist() == [0.0] + [PACE] * 7
    assert found[1:, 2].tolist() == [PACE] + [0.0] * 6
