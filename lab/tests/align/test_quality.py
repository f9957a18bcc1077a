"""The quality reward: a score in (0, 1) of the whole clip, kept whole on disk."""

from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import dips, reference_statistics, scene
from lab.tests.align.tuning_fakes import clips

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.corruption import CLEAN, paper_scores
from echoavatar_lab.align.quality import (
    PACE,
    CorruptedWindows,
    QualityConfig,
    QualityReward,
    QualityTask,
    QualityTraining,
    _with_differences,
    calibrate,
    draw_quality,
    measure_quality,
)
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.training import train


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


def calm(count: int, seed: int) -> list[TokenClip]:
    """Clips whose codes hardly change, so that corruption shows even through random weights."""
    random = np.random.default_rng(seed)
    made = []
    for clip in clips(count, chunks=20).values():
        codes = np.repeat(random.integers(2, size=(10, 3, 2)), 4, axis=0)
        made.append(TokenClip(clip.audio, codes, clip.domain))
    return made


@pytest.fixture(scope="module")
def tokenizer(tiny_bundle: Path) -> BodyTokenizer:
    return BodyTokenizer.load(tiny_bundle / "tokenizer")


@pytest.mark.slow
def test_it_ranks_corruption_on_held_out_clips(tokenizer, tmp_path):
    training = QualityTraining(steps=120, batch=12, pool=20, learning_rate=3e-3)
    model = train(
        QualityTask(CorruptedWindows(tokenizer, calm(4, 0), seed=0), QualityConfig(width=16, heads=2), training),
        tmp_path,
    ).model
    found = measure_quality(model, CorruptedWindows(tokenizer, calm(2, 1), seed=1), paper_scores(), windows=3)
    assert found["pearson_levels"] > 0.8
    assert found["levels"]["uniform 1.0"] < found["levels"]["uniform 0.1"] < found["levels"][CLEAN]
    assert set(found["unseen"]) == {"jitter", "time_warp", "foot_slide", "frozen_limbs"}
    draw_quality(found, paper_scores(), tmp_path / "q.png")
    assert (tmp_path / "q.png").stat().st_size > 5000
    assert (tmp_path / "model.safetensors").exists()


def test_levels_depend_on_seed_and_number_alone_and_rows_mix(tokenizer):
    levels = CorruptedWindows(tokenizer, calm(3, 0), seed=0)
    codes = levels.codes(3, 2)
    torch.testing.assert_close(levels.at(codes, "uniform 0.5", 7), levels.at(codes, "uniform 0.5", 7))
    assert (levels.at(codes, "uniform 0.5", 7) - levels.at(codes, "uniform 0.5", 8)).abs().max() > 0
    mixed = levels.mixed(codes, [CLEAN, "uniform 1.0"], 5)
    torch.testing.assert_close(mixed[:1], levels.at(codes[:1], CLEAN, 0))
    assert (mixed[1:] - levels.at(codes[1:], CLEAN, 0)).abs().max() > 0


def test_a_code_that_is_wrong_stays_wrong_at_higher_rates(tokenizer):
    levels = CorruptedWindows(tokenizer, calm(3, 0), seed=0)
    codes = levels.codes(0, 2)
    for kind in ("uniform", "hierarchical"):
        before = torch.zeros_like(codes, dtype=torch.bool)
        for rate in ("0.2", "0.5", "1.0"):
            made = levels._corrupted(codes, f"{kind} {rate}", 0)
            changed = made != codes
            assert not (before & ~changed).any()
            before = changed
        assert before.any()


def test_batches_hold_several_levels_of_a_window_and_are_decoded_once(tokenizer):
    levels = CorruptedWindows(tokenizer, calm(3, 0), seed=0)
    training = QualityTraining(steps=4, batch=6, levels=3, pool=2)
    stage = QualityTask(levels, QualityConfig(width=16, heads=2), training, paper_scores())
    first = stage.draw(0)
    assert all(len(set(first.scores[k : k + 3].tolist())) == 3 for k in (0, 3))
    assert torch.equal(stage.draw(2).features, first.features)
    assert not torch.equal(stage.draw(1).features, first.features)


@pytest.mark.slow
def test_calibration_finds_heavier_corruption_further_off(tokenizer):
    fid = calibrate(CorruptedWindows(tokenizer, calm(3, 0), seed=0), load_shipped(), windows=4)
    assert set(fid) == set(paper_scores())
    assert fid["uniform 1.0"] > fid["uniform 0.1"]
    assert fid["uniform 1.0"] > fid[CLEAN]
