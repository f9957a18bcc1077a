import pytest
import torch
from research.tests.bench import Ears, FakeWorkshop

from echoavatar.kinematics import HUMANOID
from echoavatar.tokenizer import as_one_part
from echoavatar_research.scores import generated, reconstructed
from echoavatar_research.workshop import motion_of


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
    clips = FakeWorkshop().tests
    found = reconstructed(Sliding(skeleton, 1e-3), clips, Ears())
    assert found["trans"].value == pytest.approx(10, rel=1e-3)
    assert found["trans"].low == pytest.approx(10, rel=1e-3)
    assert found["mpjpe"].value == pytest.approx(0, abs=1e-2)  # seen from the body, nothing moved
    assert reconstructed(Sliding(skeleton, 0.0), clips, Ears())["fid"].value == pytest.approx(0, abs=1e-4)


def test_truth_against_itself_is_no_distance() -> None:
    clips = FakeWorkshop().tests
    rows = {row.name: row for row in generated([motion_of(c) for c in clips], clips, Ears())}
    assert rows["fid"].value == pytest.approx(0, abs=1e-6)
    assert {"ba_g_paper", "ba_d_paper", "l1_diversity"} <= rows.keys()
