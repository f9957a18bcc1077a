from pathlib import Path

import pytest
import torch

from echoavatar.errors import MotionError
from echoavatar_lab.tables.skeleton_convolution import SkeletonConvolutionConfig
from echoavatar_lab.tables.skeleton_convolution_train import (
    SkeletonConvolutionTask,
    SkeletonConvolutionTraining,
    train_skeleton_convolution,
)
from echoavatar_lab.training import Loop

SMALL = SkeletonConvolutionConfig(parents=(-1, 0, 1, 2, 3, 3, 0), channels=(6, 6, 12), groups=3, reach=1)


def clips(count: int = 6) -> list[torch.Tensor]:
    """Slow waves, each channel at its own pace."""
    time = torch.arange(96)[:, None] / 30
    paces = torch.linspace(0.5, 2, 42)
    return [torch.sin(time * paces + shift) for shift in range(count)]


def settings(**changes: object) -> SkeletonConvolutionTraining:
    usual = {"steps": 60, "batch": 8, "frames": 32, "warmup": 5, "learning_rate": 5e-3}
    return SkeletonConvolutionTraining.model_validate(usual | changes)


@pytest.mark.slow
def test_it_learns_to_give_motion_back(tmp_path: Path) -> None:
    made = clips()
    model = train_skeleton_convolution(SMALL, settings(), made, tmp_path)
    back = model.decode(model.encode(made[0][None]))
    assert (back - made[0]).square().mean() < 0.5 * made[0].var()
    assert len(model.features(made[0])) == 96 // 4


def test_masks_between_strangers_and_unused_heads_stay_as_they_are() -> None:
    stage = SkeletonConvolutionTask(SMALL, settings(), clips())
    before = {name: value.clone() for name, value in stage.model.state_dict().items()}
    Loop(stage).advance()
    after = stage.model.state_dict()
    kept = {name for name in after if name.endswith("mask") or name.startswith(("fc_", "encoder.layers.0.0.common"))}
    assert kept
    assert all(torch.equal(before[name], after[name]) for name in kept)
    assert not torch.equal(
        before["encoder.layers.0.0.residual.0.weight"], after["encoder.layers.0.0.residual.0.weight"]
    )


def test_a_step_draws_the_same_windows_again() -> None:
    one, two = (SkeletonConvolutionTask(SMALL, settings(), clips()) for _ in range(2))
    assert torch.equal(one.draw(3), two.draw(3))
    assert not torch.equal(one.draw(3), one.draw(4))


def test_clips_that_are_too_short_are_refused() -> None:
    with pytest.raises(MotionError, match="32 frames"):
        SkeletonConvolutionTask(SMALL, settings(), [clip[:20] for clip in clips()])
