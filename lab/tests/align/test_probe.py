"""The true motion costs nothing; motion that stands still costs FID and diversity."""

import av
import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import book, clips, policy, wants_threes

from echoavatar.engine.pipeline import load_bundle
from echoavatar_lab.align import probe as room
from echoavatar_lab.align.decoded_motion import decode_continuations
from echoavatar_lab.align.policy import GeneratorPolicy
from echoavatar_lab.align.probe import DecodingJudge, MotionMetrics, Probe, SampleVideos, mean_and_error
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import RewardMix
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped
from echoavatar_lab.models.tokenizer.model import BodyTokenizer


def test_the_truth_costs_nothing_and_stillness_does(tiny_bundle):
    import torch

    tokenizer = BodyTokenizer.load(tiny_bundle / "tokenizer")
    prompts = PromptSampler(clips(3, chunks=8), past=2, length=4).spread(3)
    motion_metrics = MotionMetrics(tokenizer, prompts, load_shipped(), reference_statistics())
    same = motion_metrics(motion_metrics.truth)
    assert same["fid"] == pytest.approx(0, abs=1e-2)
    still = motion_metrics(decode_continuations(tokenizer, prompts, torch.zeros(3, 8, 3, 2, dtype=torch.int64)))
    assert still["fid"] > 10 * abs(same["fid"]) + 0.1
    assert still["diversity"] < same["diversity"]
    assert {"beat_alignment", "diversity", "fid"} <= same.keys()


def test_means_come_with_their_standard_error():
    import numpy as np

    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0)
    assert mean_and_error(np.array([1.0])) == (1.0, 0.0)


def test_pieces_change_nothing(tiny_bundle, monkeypatch):
    judge = DecodingJudge(
        BodyTokenizer.load(tiny_bundle / "tokenizer"),
        RewardMix({"beats": 1.0, "smoothness": 1.0}, reference_statistics()),
    )
    prompts = PromptSampler(clips(), past=1, length=3).spread(3)
    codes = torch.randint(8, (6, 6, 3, 2), generator=torch.Generator().manual_seed(0))
    whole = judge(prompts, codes)
    monkeypatch.setattr(room, "PIECE", 2)
    pieces = judge(prompts, codes)
    np.testing.assert_allclose(pieces.total, whole.total, atol=1e-6)
    assert whole.parts.keys() == {"beats", "smoothness"}
    assert whole.tokens.shape == (6, 6)


def test_the_reward_is_that_of_the_continuations_and_pieces_change_nothing(monkeypatch):
    one, prompts = GeneratorPolicy(policy()), book().spread(5)
    found = Probe(prompts, wants_threes, group=3)(one, one)
    assert found["kl"] == pytest.approx(0, abs=1e-6)
    assert found["reward"] == found["rewards"]["threes"]
    assert sum(found["by_prompt"]) / 5 == pytest.approx(found["reward"][0], abs=1e-4)
    assert 0.02 < found["reward"][0] < 0.3  # an eighth by chance
    monkeypatch.setattr(room, "TOGETHER", 2)
    again = Probe(prompts, wants_threes, group=3)(one, one)
    assert again["by_prompt"] == found["by_prompt"]
    other = Probe(prompts, wants_threes, group=3, seed=1)(one, one)
    assert other["by_prompt"] != found["by_prompt"]


def test_motion_metrics_are_reported_with_the_rewards(tiny_bundle):
    bundle = load_bundle(tiny_bundle)
    prompts = PromptSampler(clips(3, chunks=8), past=2, length=4).spread(3)
    judge = DecodingJudge(bundle.tokenizer, RewardMix({"smoothness": 1.0}, reference_statistics()))
    motion_metrics = MotionMetrics(bundle.tokenizer, prompts, load_shipped(), reference_statistics())
    one = GeneratorPolicy(bundle.generator)
    found = Probe(prompts, judge, group=2, motion_metrics=motion_metrics)(one, one)
    plain = Probe(prompts, judge, group=2)(one, one)
    assert found["by_prompt"] == plain["by_prompt"]
    assert found["fid"] > 0
    assert "fid" not in plain


def test_videos_of_prompts(tiny_bundle, tmp_path):
    bundle = load_bundle(tiny_bundle)
    prompts = PromptSampler(clips(2, chunks=8), past=1, length=1).spread(2)
    videos = SampleVideos(bundle.codec, bundle.tokenizer, prompts)
    videos(GeneratorPolicy(bundle.generator), tmp_path / "samples" / "step_000001")
    files = sorted(path.name for path in (tmp_path / "samples").iterdir())
    assert files == ["step_000001_0.mp4", "step_000001_1.mp4"]
    with av.open(str(tmp_path / "samples" / files[0])) as video:
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert len(pictures) == 16
        assert np.ptp(pictures[0]) > 50  # a body before a ground
        assert video.streams.audio
