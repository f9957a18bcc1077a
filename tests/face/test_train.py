import json

import numpy as np
import pytest
import torch
from tests.face.tiny import CONFIG

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.face import FaceStream
from echoavatar.face.arkit import ARKIT_NAMES
from echoavatar.face.clip import FaceClip
from echoavatar.face.train import FaceSampler, FaceTrainer, FaceTraining, _lip_error, flow_loss, train_face

JAW = ARKIT_NAMES.index("jawOpen")
QUICK = FaceTraining(steps=6, batch=2, frames=16, warmup=1, save_every=2, learning_rate=3e-3)


def clip(frames: int = 160, seed: int = 0, split: str = "train") -> FaceClip:
    """The jaw follows the loudness of noise, which changes every 12 frames."""
    rng = np.random.default_rng(seed)
    jaw = np.repeat(rng.choice([0.0, 0.5], frames // 12 + 1), 12)[:frames].astype(np.float32)
    audio = np.repeat(jaw, 800) * rng.normal(0, 0.4, frames * 800)
    curves = np.zeros((frames, 52), np.float32)
    curves[:, JAW] = jaw
    return FaceClip(f"c{seed}", audio.clip(-1, 1).astype(np.float32), curves, split)


def losses(folder) -> list[float]:
    return [json.loads(line)["loss"] for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path):
    whole = train_face(CONFIG, QUICK, [clip()], tmp_path / "whole")
    trainer = FaceTrainer(CONFIG, QUICK, [clip()])
    for _ in range(3):
        trainer.step()
    trainer.save(tmp_path / "cut")
    cut = train_face(CONFIG, QUICK, [clip()], tmp_path / "cut")
    assert losses(tmp_path / "cut") == losses(tmp_path / "whole")[3:]
    for key, value in whole.state_dict().items():
        assert torch.equal(cut.state_dict()[key], value), key


def test_another_schedule_or_size_is_refused(tmp_path):
    FaceTrainer(CONFIG, QUICK, [clip()]).save(tmp_path)
    with pytest.raises(CheckpointError, match="other settings"):
        train_face(CONFIG, QUICK.model_copy(update={"seed": 1}), [clip()], tmp_path)
    with pytest.raises(CheckpointError, match="another config"):
        train_face(CONFIG.model_copy(update={"width": 32}), QUICK, [clip()], tmp_path)


def test_it_learns_to_open_the_jaw_with_the_sound(tmp_path):
    """A tiny model overfits one clip: streamed from nothing but sound, its jaw follows the truth."""
    training = FaceTraining(steps=250, batch=8, frames=32, warmup=10, learning_rate=5e-3, save_every=1000)
    model = train_face(CONFIG, training, [clip()], tmp_path)
    assert np.mean(losses(tmp_path)[-20:]) < 0.35 * np.mean(losses(tmp_path)[:10])
    truth = clip()
    stream, active = FaceStream(model), torch.ones(1, dtype=torch.bool)
    audio = torch.from_numpy(truth.audio)[None]
    curves = stream.step(audio, stream.init_state(1), active, torch.tensor([5]))[0].numpy()
    assert np.corrcoef(curves[:, JAW], truth.curves[:, JAW])[0, 1] > 0.8
    mouth = [i for i, name in enumerate(ARKIT_NAMES) if name.startswith(("mouth", "jaw")) and i != JAW]
    assert np.abs(curves[:, mouth]).max() == 0


def test_windows_are_the_same_for_the_same_step_and_sound_fits_the_face():
    sampler = FaceSampler([clip()], frames=16, seed=3)
    one, two = sampler.batch(7, 4), sampler.batch(7, 4)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one.curves, sampler.batch(8, 4).curves)
    loud = one.audio.unflatten(1, (16, 800)).square().mean(2).sqrt()
    assert torch.corrcoef(torch.stack([loud.flatten(), one.curves[..., JAW].flatten()]))[0, 1] > 0.9


def test_silence_and_lost_history_are_dropped_per_window():
    """With all sound dropped the loss does not depend on it; with none dropped it does."""
    trainer = FaceTrainer(CONFIG, QUICK, [clip()])
    batch = trainer.sampler.batch(0, 4)
    deaf = batch._replace(audio=torch.zeros_like(batch.audio))

    def loss(data, share: float) -> float:
        training = QUICK.model_copy(update={"audio_dropout": share})
        return flow_loss(trainer.model, data, training, torch.Generator().manual_seed(0)).item()

    assert loss(batch, 1.0) == loss(deaf, 1.0)
    assert loss(batch, 0.0) != loss(deaf, 0.0)


def test_clips_too_short_for_a_window_are_named():
    with pytest.raises(MotionError, match="longer than 300 frames"):
        FaceSampler([clip()], frames=300, seed=0)


def test_a_new_run_begins_with_another_models_weights(tmp_path):
    first = train_face(CONFIG, QUICK, [clip()], tmp_path / "first")
    still = QUICK.model_copy(update={"learning_rate": 1e-12})
    second = train_face(CONFIG, still, [clip()], tmp_path / "second", start=first)
    for key, value in first.state_dict().items():
        torch.testing.assert_close(second.state_dict()[key], value, atol=1e-6, rtol=1e-5)


def test_lips_that_should_touch_and_do_not_cost_most():
    shut, open_ = torch.zeros(1, 4, 52), torch.zeros(1, 4, 52)
    open_[..., JAW] = 0.2
    assert _lip_error(shut[None], shut) == 0
    assert _lip_error(open_[None], shut) == pytest.approx(4 * 4.0)
    assert _lip_error(shut[None], open_) == pytest.approx(4.0)
