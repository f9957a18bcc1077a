import pytest
import torch
from lab.tests.fakes import FakeExperiment, FakeExtractor

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.train import as_one_part
from echoavatar_lab.tables.scores import generation_scores, reconstruction_scores


class Sliding:
    """A tokenizer that keeps everything but adds a millimetre a frame to the side."""

    def __init__(self, skeleton, step: float) -> None:
        self.skeleton, self.step = skeleton, step

    def encode(self, features: torch.Tensor) -> torch.Tensor:
        return features

    def decode(self, codes: torch.Tensor) -> torch.Tensor:
        moved = codes.clone()
        moved[..., 6 * len(next(iter(self.skeleton.config.parts.values())))] += self.step
        return moved


@pytest.mark.parametrize("skeleton", [HUMANOID, as_one_part(HUMANOID)], ids=["parts", "whole"])
def test_a_slide_of_a_millimetre_is_ten_of_the_papers_units(skeleton) -> None:
    clips = FakeExperiment().test_clips
    found = reconstruction_scores(Sliding(skeleton, 1e-3), clips, FakeExtractor())
    assert found["trans"].value == pytest.approx(10, rel=1e-3)
    assert found["trans"].low == pytest.approx(10, rel=1e-3)
    assert found["mpjpe"].value == pytest.approx(0, abs=1e-2)  # seen from the body, nothing moved
    assert reconstruction_scores(Sliding(skeleton, 0.0), clips, FakeExtractor())["fid"].value == pytest.approx(
        0, abs=1e-4
    )


def test_truth_against_itself_is_no_distance() -> None:
    clips = FakeExperiment().test_clips
    rows = {row.name: row for row in generation_scores([c.motion() for c in clips], clips, FakeExtractor())}
    assert rows["fid"].value == pytest.approx(0, abs=1e-6)
    assert {"ba_g_paper", "ba_d_paper", "l1_diversity"} <= rows.keys()
