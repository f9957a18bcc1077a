import pytest
import torch
from tests.models.motion_tokens import dance, small_config

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.measure import code_usage, measure
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import clip_features


def test_usage_counts_codes_that_occur_and_ignores_skipped_layers():
    """Layer 0 uses 2 of 4 codes equally (perplexity 2); layer 1 uses one, and -1 does not count."""
    codes = torch.tensor([[[0, 3], [1, -1], [0, 3], [1, -1]]])
    usage = code_usage(codes, 4)
    assert usage.fraction.tolist() == [0.5, 0.25]
    assert usage.perplexity.tolist() == pytest.approx([2.0, 1.0])


class Perfect(BodyTokenizer):
    """A tokenizer that keeps everything but lifts the root and slides it."""

    def __init__(self, lift: float = 0.0, slide: float = 0.0) -> None:
        super().__init__(small_config())
        self.lift, self.slide = lift, slide

    def encode(self, features: torch.Tensor) -> torch.Tensor:
        self.features = features
        return (
            torch.arange(16)
            .repeat(features.shape[1] // 64 + 1)[: features.shape[1] // 4][None, :, None, None]
            .repeat(1, 1, 3, 2)
        )

    def decode(self, codes: torch.Tensor) -> torch.Tensor:
        return self.features + torch.nn.functional.pad(torch.tensor([self.slide, 0, self.lift]), (54, 258))


def test_a_perfect_tokenizer_scores_zero():
    scores = measure(Perfect(), [clip_features(HUMANOID, dance(0, 131))])
    assert scores.mpjpe_body_mm == scores.mpjpe_hands_mm == scores.root_velocity_mm == 0
    assert scores.usage["hands"] == [1.0, 1.0]
    assert scores.perplexity["lower"][0] == pytest.approx(16, abs=0.5)


def test_lift_counts_for_the_body_and_not_for_fingers():
    """5 mm up: every body joint 5 mm off, fingers unmoved from their wrist."""
    scores = measure(Perfect(lift=0.005), [clip_features(HUMANOID, dance(0, 64))])
    assert scores.mpjpe_body_mm == pytest.approx(5, rel=1e-3)
    assert scores.mpjpe_hands_mm == pytest.approx(0, abs=1e-3)


def test_slide_counts_as_root_velocity_and_skating():
    """A statue slid by 2 mm a frame: velocity error 2 mm, its feet skate at 2 mm * 30 = 6 cm per second."""
    statue = clip_features(HUMANOID, dance(0, 64))[:1].repeat(64, 1)
    statue[:, 54:56] = 0
    scores = measure(Perfect(slide=0.002), [statue])
    assert scores.root_velocity_mm == pytest.approx(2, rel=1e-3)
    assert scores.skate_cm_s == pytest.approx(6, rel=1e-3)
