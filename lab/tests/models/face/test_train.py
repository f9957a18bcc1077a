import numpy as np
import pytest
import torch
from pydantic import ValidationError
from tests.models.face.tiny import CONFIG, JAW, clip
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.models.face.clip import FaceClip
from echoavatar_lab.models.face.train import (
    FaceReader,
    FaceSampler,
    FaceTask,
    FaceTraining,
    at_speed,
    draw_noise,
    flow_loss,
    lip_error,
    normalized,
    resample_curves,
    stretch,
)
from echoavatar_lab.training import Loop, train


def test_windows_are_whole_chunks_and_unknown_names_are_refused():
    assert FaceTraining(frames=32).frames == 32
    with pytest.raises(ValidationError, match="frames"):
        FaceTraining(frames=30)
    with pytest.raises(ValidationError, match="lip"):
        FaceTraining(lip=0.3)


def clicks_and_hum(seconds: float = 2.0) -> np.ndarray:
    time = np.arange(int(seconds * 24_000)) / 24_000
    loud = np.where(np.abs((time % 0.5) - 0.25) < 0.05, 1.0, 0.02)
    return (0.3 * loud * np.sin(2 * np.pi * 200 * time)).astype(np.float32)


@pytest.mark.parametrize("speed", [0.9, 1.1])
def test_pitch_stays_and_time_moves(speed):
    """Bursts every 0.5 s come every 0.5 / speed s; the strongest frequency remains 200 Hz."""
    sound = clicks_and_hum()
    slow = stretch(sound, round(len(sound) / speed))
    assert len(slow) == round(len(sound) / speed)
    spectrum = np.abs(np.fft.rfft(slow * np.hanning(len(slow))))
    assert abs(np.argmax(spectrum) * 24_000 / len(slow) - 200) < 3
    for burst in range(4):
        middle = (burst + 0.5) * 0.5 / speed
        near = slow[int((middle - 0.1) * 24_000) : int((middle + 0.1) * 24_000)] ** 2
        found = middle - 0.1 + (near * np.arange(len(near))).sum() / near.sum() / 24_000
        assert abs(found - middle) < 0.012
    assert abs(slow.std() / sound.std() - 1) < 0.1


def test_the_same_length_is_nearly_the_same_sound():
    sound = clicks_and_hum()
    assert np.abs(stretch(sound, len(sound)) - sound)[1000:-1000].max() < 0.02


def test_curves_follow_a_cubic():
    """A parabola is its own spline: the middles of the new frames lie on it."""
    t = np.arange(30) + 0.5
    curves = ((t / 30 - 0.5) ** 2)[:, None]
    n = np.arange(20) + 0.5
    np.testing.assert_allclose(resample_curves(curves, 20)[2:-2, 0], ((n / 20 - 0.5) ** 2)[2:-2], atol=1e-6)
    assert resample_curves(np.ones((1, 3)), 4).shape == (4, 3)


def test_sound_and_face_stay_together():
    clip = FaceClip("a", clicks_and_hum(), np.zeros((60, 52), np.float32))
    fast = at_speed(clip, 1.1)
    assert len(fast.curves) == 55
    assert len(fast.audio) == 55 * 800
    assert at_speed(clip, 1.0) is clip


def test_windows_are_the_same_for_the_same_step_and_sound_fits_the_face():
    sampler = FaceSampler([clip()], frames=16, seed=3)
    one, two = sampler.batch(7, 4), sampler.batch(7, 4)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one.curves, sampler.batch(8, 4).curves)
    loud = one.audio.unflatten(1, (16, 800)).square().mean(2).sqrt()
    assert torch.corrcoef(torch.stack([loud.flatten(), one.curves[..., JAW].flatten()]))[0, 1] > 0.9


def test_clips_too_short_for_a_window_are_named():
    with pytest.raises(MotionError, match="longer than 300 frames"):
        FaceSampler([clip()], frames=300, seed=0)


def test_speeds_are_those_asked_for():
    """At one speed every window lies in the clip as it is; faster, most do not."""
    truth = torch.from_numpy(clip().audio)

    def found(speed: float) -> int:
        batch = FaceSampler([clip()], frames=16, seed=3, speeds=(speed,)).batch(0, 20)
        return sum(bool((truth.unfold(0, 12_800, 800) == window).all(1).any()) for window in batch.audio)

    assert found(1.0) == 20
    assert found(1.1) < 15


def test_a_late_face_is_that_of_the_frame_before_and_the_sound_stays():
    now, late = (FaceSampler([clip()], frames=16, seed=3, late=frames).batch(0, 6) for frames in (0, 2))
    assert torch.equal(now.audio, late.audio)
    assert torch.equal(now.curves[:, 1:-2], late.curves[:, 3:])
    assert torch.equal(now.before, late.curves[:, 1])


QUICK = FaceTraining(batch=2, frames=16)


def test_silence_and_lost_history_are_dropped_per_window():
    """With all sound dropped the loss does not depend on it; with none dropped it does."""
    stage = FaceTask(CONFIG, QUICK, [clip()])
    batch = stage.sampler.batch(0, 4)
    deaf = batch._replace(audio=torch.zeros_like(batch.audio))

    def loss(data, share: float) -> float:
        training = QUICK.model_copy(update={"audio_dropout": share})
        features = stage.model.encoder(data.audio)
        noise = draw_noise(data.curves, training, torch.Generator().manual_seed(0))
        return flow_loss(stage.model, data, training, noise, features=features).item()

    assert loss(batch, 1.0) == loss(deaf, 1.0)
    assert loss(batch, 0.0) != loss(deaf, 0.0)


def test_lips_that_should_touch_and_do_not_cost_most():
    shut, open_ = torch.zeros(1, 4, 52), torch.zeros(1, 4, 52)
    open_[..., JAW] = 0.2
    assert lip_error(shut[None], shut) == 0
    assert lip_error(open_[None], shut) == pytest.approx(4 * 4.0)
    assert lip_error(shut[None], open_) == pytest.approx(4.0)


@torch.no_grad()
def test_a_reader_that_tells_face_and_touch_pays_nothing_and_any_other_does():
    """Features are the normalised face and a large logit that its lips touch; the readout passes them on."""
    model = FaceTask(CONFIG, QUICK, [clip()]).model
    curves = torch.zeros(1, 4, 52)
    curves[0, 2:, JAW] = 0.4
    touching = torch.tensor([20.0, 20.0, -20.0, -20.0])
    features = torch.cat([normalized(model, curves), touching[None, :, None]], -1)
    reader = FaceReader(53, 52)
    torch.nn.init.eye_(reader.read.weight)
    torch.nn.init.zeros_(reader.read.bias)
    assert reader.loss(model, features, curves) < 1e-6
    deaf = features.clone()
    deaf[..., -1] *= -1
    assert reader.loss(model, deaf, curves) == pytest.approx(20.0, rel=1e-3)
    assert reader.loss(model, features.flip(1), curves) > 20.0


TRAIN_QUICK = FaceTraining(steps=6, batch=2, frames=16, warmup=1, save_every=2, learning_rate=3e-3)


@pytest.mark.parametrize("at", [1, 5])
def test_a_killed_run_repeats_the_curve_it_would_have_had(tmp_path, at):
    """Two steps train the encoder alone, then all learn; checkpoints come every second step."""
    training = TRAIN_QUICK.model_copy(update={"listen": 2, "average": 0.5})
    check_resume(
        lambda folder, **how: train(FaceTask(CONFIG, training, [clip()]), folder, **how).model, tmp_path, at=at
    )


def test_pieces_share_one_trajectory():
    """Four windows at once or one after the other, with the noise that each has in either."""

    def make(pieces):
        training = TRAIN_QUICK.model_copy(update={"batch": 4, "accumulation": pieces, "listen": 1})
        return FaceTask(CONFIG, training, [clip()])

    check_pieces(make, 4)


def test_another_schedule_or_size_is_refused(tmp_path):
    Loop(FaceTask(CONFIG, TRAIN_QUICK, [clip()])).save(tmp_path)
    with pytest.raises(CheckpointError, match="another training config: seed"):
        train(FaceTask(CONFIG, TRAIN_QUICK.model_copy(update={"seed": 1}), [clip()]), tmp_path)
    with pytest.raises(CheckpointError, match="another face config: width"):
        train(FaceTask(CONFIG.model_copy(update={"width": 32}), TRAIN_QUICK, [clip()]), tmp_path)


def test_it_learns_to_open_the_jaw_with_the_sound(tmp_path):
    """A tiny model overfits one clip: streamed from nothing but sound, its jaw follows the truth."""
    training = FaceTraining(steps=80, batch=4, frames=32, warmup=10, learning_rate=5e-3, save_every=1000)
    model = train(FaceTask(CONFIG, training, [clip()]), tmp_path).model
    curve = list(losses(tmp_path).values())
    assert np.mean(curve[-20:]) < 0.35 * np.mean(curve[:10])
    truth = clip()
    stream = model.stream()
    curves = stream.step(truth.audio[None], stream.init_state(1), np.ones(1, np.bool_), np.array([5]))[0]
    assert np.corrcoef(curves[:, JAW], truth.curves[:, JAW])[0, 1] > 0.8
    mouth = [i for i, name in enumerate(ARKIT_NAMES) if name.startswith(("mouth", "jaw")) and i != JAW]
    assert np.abs(curves[:, mouth]).max() == 0


def test_a_new_run_begins_with_another_models_weights(tmp_path):
    first = train(FaceTask(CONFIG, TRAIN_QUICK, [clip()]), tmp_path / "first").model
    still = TRAIN_QUICK.model_copy(update={"learning_rate": 1e-12})
    second = train(FaceTask(CONFIG, still, [clip()]), tmp_path / "second", start=first).model
    for key, value in first.state_dict().items():
        torch.testing.assert_close(second.state_dict()[key], value, atol=1e-6, rtol=1e-5)


def test_at_first_only_the_encoder_learns():
    """Two steps of listening, then one of all; with a rate of its own for either phase."""
    training = TRAIN_QUICK.model_copy(update={"listen": 2, "listening_rate": 1e-2, "warmup": 0})
    loop = Loop(FaceTask(CONFIG, training, [clip()]))
    before = {key: value.clone() for key, value in loop.stage.model.state_dict().items()}
    assert loop.stage.rate(0, 0.0) == 1e-2
    assert loop.stage.rate(2, 0.5) == training.learning_rate
    for _ in range(2):
        loop.advance()

    def changed() -> set[str]:
        after = loop.stage.model.state_dict()
        return {key.split(".")[0] for key, value in before.items() if not torch.equal(after[key], value)}

    assert changed() == {"encoder"}
    loop.advance()
    assert changed() == {"encoder", "gpt", "head"}


def test_the_encoder_alone_learns_to_tell_the_jaw():
    """The readout's error falls to a third within 60 steps of a tiny encoder on one clip."""
    training = FaceTraining(steps=60, listen=60, batch=4, frames=32, warmup=5, listening_rate=1e-2)
    loop = Loop(FaceTask(CONFIG, training, [clip()]))
    errors = [loop.advance()["read"] for _ in range(60)]
    assert np.mean(errors[-5:]) < np.mean(errors[:3]) / 3
