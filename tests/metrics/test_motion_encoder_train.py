from pathlib import Path

import pytest
import torch

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.metrics.motion_encoder import MotionEncoderConfig
from echoavatar.metrics.motion_encoder_train import (
    MotionEncoderTrainer,
    MotionEncoderTraining,
    explained,
    part_weights,
    train_motion_encoder,
)

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


def test_it_learns_what_is_there_to_learn(tmp_path: Path) -> None:
    told: list[int] = []
    model = train_motion_encoder(
        CONFIG, TRAINING, clips(), tmp_path, progress=lambda done, total: told.append(done)
    )
    assert explained(model, clips()) > 0.6
    assert told == list(range(1, 61))
    assert {path.name for path in tmp_path.iterdir()} >= {"config.json", "model.safetensors", "card.json"}
    latents = torch.cat([model.features(clip) for clip in clips()])
    torch.testing.assert_close(latents.std(0), torch.ones(4), atol=0.05, rtol=0)


def test_a_stopped_run_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = MotionEncoderTrainer(CONFIG, TRAINING, clips())
    losses = [whole.step()["loss"] for _ in range(6)]
    first = MotionEncoderTrainer(CONFIG, TRAINING, clips())
    for _ in range(3):
        first.step()
    first.save(tmp_path)
    second = MotionEncoderTrainer(CONFIG, TRAINING, clips())
    assert second.resume(tmp_path)
    assert [second.step()["loss"] for _ in range(3)] == pytest.approx(losses[3:], rel=1e-5)


def test_other_settings_and_damage_are_refused(tmp_path: Path) -> None:
    MotionEncoderTrainer(CONFIG, TRAINING, clips()).save(tmp_path)
    other = MotionEncoderTrainer(CONFIG, TRAINING.model_copy(update={"steps": 7}), clips())
    with pytest.raises(CheckpointError, match="other settings"):
        other.resume(tmp_path)
    (tmp_path / "resume.safetensors").write_bytes(b"no")
    with pytest.raises(CheckpointError, match="damaged"):
        MotionEncoderTrainer(CONFIG, TRAINING, clips()).resume(tmp_path)


def test_clips_that_are_too_short_are_named() -> None:
    with pytest.raises(MotionError, match="32 frames"):
        MotionEncoderTrainer(CONFIG, TRAINING, [torch.zeros(31, 6)])


def test_every_part_of_the_body_has_the_same_say() -> None:
    weights = part_weights(316)
    assert float(weights.sum()) == pytest.approx(1)
    assert float(weights[-4:].sum()) == pytest.approx(0.25)
    torch.testing.assert_close(part_weights(5), torch.full((5,), 0.2))
