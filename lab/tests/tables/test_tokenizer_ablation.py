import pytest
import torch
from lab.tests.fakes import FakeExperiment, counted

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.losses import MotionLoss
from echoavatar_lab.models.tokenizer.train import as_one_part
from echoavatar_lab.tables import scores, tokenizer_ablation
from echoavatar_lab.tables.tokenizer_ablation import NO_AUXILIARY, VARIANTS


class Exact:
    """A tokenizer that loses nothing."""

    def __init__(self, skeleton) -> None:
        self.skeleton = skeleton

    def encode(self, features: torch.Tensor) -> torch.Tensor:
        return features

    decode = encode


class Experiment(FakeExperiment):
    def tokenizer(self, choice):
        return Exact(as_one_part(HUMANOID) if choice.is_whole else HUMANOID)


def test_all_lines_have_all_four_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    table = tokenizer_ablation.make(Experiment())
    keys = {"fid", "mpjpe", "trans", "generation_fid"}
    assert [line.name for line in table.lines[2:]] == [name for name, _, _ in VARIANTS]
    for line in table.lines[2:]:
        assert line.paper.keys() == line.ours.keys() == keys
        assert line.ours["mpjpe"].value < 1e-2
    assert table.lines[1].ours["fid"].value > 0


def test_without_auxiliary_only_features_count() -> None:
    loss = MotionLoss(as_one_part(HUMANOID), NO_AUXILIARY)
    truth = torch.randn(1, 8, 315, generator=torch.Generator().manual_seed(0))
    terms = loss(truth + 0.1, truth, mean=torch.zeros(315), std=torch.ones(315))
    assert [name for name, value in terms.items() if value > 0] == ["features"]


def test_only_the_full_model_has_parts() -> None:
    assert [tokenizer.is_whole for _, _, tokenizer in VARIANTS] == [True] * 5 + [False]
