from pathlib import Path

import pytest
import torch

from echoavatar.errors import MotionError
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoderConfig
from echoavatar_lab.evaluation.metrics.motion_encoder_train import (
    MotionEncoderTask,
    MotionEncoderTraining,
    explained_variance,
    part_weights,
)
from echoavatar_lab.training import Loop, train

CONFIG = MotionEncoderConfig(features=6, width=16, latent=4)
TRAINING = MotionEncoderTraining(steps=60, batch=8, frames=32, warmup=5, save_every=10)


def clips() -> list[torch.Tensor]:
    """Six channels that are mixtures of two slow waves."""
    random = torch.Generator().manual_seed(0)
    mix = torch.randn(2, 6, generator=random)
    found = []
    for start in range(5):
        t = torch.arange(200)[:, None] / 30 + start
        found.append(torch.cat([torch.sin(3 * t), torch.cos(2 * t)], 1) @ mix)
    return found


def test_training_explains_the_variance(tmp_path: Path) -> None:
    told: list[int] = []
    model = train(
        MotionEncoderTask(CONFIG, TRAINING, clips()), tmp_path, progress=lambda done, total: told.append(done)
    ).model
    assert explained_variance(model, clips()) > 0.6
    assert told == list(range(1, 61))
    assert {path.name for path in tmp_path.iterdir()} >= {"config.json", "model.safetensors", "card.json"}
    latents = torch.cat([model.features(clip) for clip in clips()])
    torch.testing.assert_close(latents.std(0), torch.ones(4), atol=0.05, rtol=0)


def test_a_stopped_run_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    """Though the latents' spread is measured with every checkpoint."""
    whole = Loop(MotionEncoderTask(CONFIG, TRAINING, clips()))
    losses = [whole.advance()["loss"] for _ in range(6)]
    first = Loop(MotionEncoderTask(CONFIG, TRAINING, clips()))
    for _ in range(3):
        first.advance()
    first.save(tmp_path)
    second = Loop(MotionEncoderTask(CONFIG, TRAINING, clips()))
    assert second.resume(tmp_path)
    assert [second.advance()["loss"] for _ in range(3)] == losses[3:]


def test_clips_that_are_too_short_are_named() -> None:
    with pytest.raises(MotionError, match="32 frames"):
        MotionEncoderTask(CONFIG, TRAINING, [torch.zeros(31, 6)])


def test_every_part_of_the_body_has_the_same_say() -> None:
    weights = part_weights(316)
    assert float(weights.sum()) == pytest.approx(1)
    assert float(weights[-4:].sum()) == pytest.approx(0.25)
    torch.testing.assert_close(part_weights(5), torch.full((5,), 0.2))
