"""The true motion costs nothing; motion that stands still costs FID and diversity."""

import pytest
from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import clips

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar_lab.align.decoded_motion import decode_continuations
from echoavatar_lab.align.motion_metrics import MotionMetrics, mean_and_error
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.evaluation.metrics.motion_encoder import load_shipped


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
