"""Training learns what audio says, and resumes to the same curve."""

import json

import numpy as np
import pytest
import torch
from tests.generator.tiny import config

from echoavatar.errors import CheckpointError
from echoavatar.generator import Generator, TokenClip, WindowSampler, nll_by_domain
from echoavatar.generator.train import GeneratorTraining, Trainer, train_generator


def clips(count=4, chunks=12):
    """Motion that follows the audio of its chunk: every code is the first audio code of the chunk, modulo 8."""
    rng = np.random.default_rng(0)
    made = []
    for _ in range(count):
        key = rng.integers(16, size=chunks)
        audio = np.repeat(key, 20)[:, None].repeat(2, 1)
        motion = np.repeat(key % 8, 2)[:, None, None] * np.ones((1, 3, 2), int)
        made.append(TokenClip(audio, motion, np.full(2 * chunks, 1, np.uint8)))
    return made


def settings(**changes):
    usual = {"steps": 6, "batch": 2, "chunks": 4, "warmup": 2, "depth_weights": (1.0, 0.5), "save_every": 3}
    return GeneratorTraining(**(usual | changes))


def losses(folder):
    rows = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
    return [(row["step"], row["loss"]) for row in rows]


@pytest.mark.parametrize(
    ("sequence", "optimiser"), [("interleaved", "adamw"), ("interleaved", "muon"), ("prefix", "adamw")]
)
def test_a_run_that_was_killed_resumes_to_the_same_curve(tmp_path, sequence, optimiser):
    """Killed after step 4 of 6, with its last checkpoint at step 3: steps 3 to 5 are repeated."""

    class KilledError(Exception):
        pass

    def kill(step, _):
        if step == 5:
            raise KilledError

    shape, training = (
        config(sequence=sequence),
        settings(optimiser=optimiser, cue_weight=0.1, out_of_step=0.5),
    )
    train_generator(shape, training, clips(), tmp_path / "whole")
    with pytest.raises(KilledError):
        train_generator(shape, training, clips(), tmp_path / "killed", progress=kill)
    train_generator(shape, training, clips(), tmp_path / "killed")
    assert losses(tmp_path / "killed") == losses(tmp_path / "whole")
    whole, killed = (Generator.load(tmp_path / name).state_dict() for name in ("whole", "killed"))
    assert all(torch.equal(whole[key], killed[key]) for key in whole)


def test_training_learns_to_follow_the_audio(tmp_path):
    """Uniform guessing costs ln 8 = 2.08 nats. With another clip's audio the first code of each chunk is a surprise,
    and the 11 others contradict the audio."""
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5)
    model = train_generator(config(layers=1), training, clips(16), tmp_path)
    held = clips(20)[16:]
    true, shuffled = nll_by_domain(model, held), nll_by_domain(model, held, shuffled_audio=True)
    assert true["speech"] < 1.0
    assert shuffled["speech"] > true["speech"] + 0.4


def test_targets_stay_clean_and_context_is_corrupted():
    trainer = Trainer(config(), settings(corruption_low=1.0, corruption_high=1.0))
    window = WindowSampler(clips(), chunks=4).batch(0, 2)
    damaged = trainer._corrupted(window, 0)
    clean = trainer.generator.config.order.build(
        window.audio, window.motion, window.motion, torch.zeros(2).long()
    )
    assert torch.equal(damaged.targets, clean.targets)
    assert 0.3 < (damaged.ids != clean.ids).float().sum() / (2 * 8 * 6) < 0.9


def test_a_blind_window_has_noise_for_context_and_clean_targets():
    trainer = Trainer(config(), settings(corruption="none", blind=1.0))
    window = WindowSampler(clips(), chunks=4).batch(0, 2)
    made = trainer._corrupted(window, 0)
    clean = trainer.generator.config.order.build(
        window.audio, window.motion, window.motion, torch.zeros(2).long()
    )
    assert torch.equal(made.targets, clean.targets)
    assert (made.ids != clean.ids).sum() > 0.75 * 2 * 8 * 6  # 7 of 8 random codes differ


def test_a_window_out_of_step_has_late_or_early_context_and_targets_in_time():
    trainer = Trainer(config(), settings(corruption="none", out_of_step=1.0))
    window = WindowSampler(clips(), chunks=4).batch(0, 2)
    made = trainer._corrupted(window, 0)
    order, none = trainer.generator.config.order, torch.zeros(2).long()
    assert torch.equal(made.targets, order.build(window.audio, window.motion, window.motion, none).targets)
    for row in range(2):
        moved = [
            order.build(window.audio, window.motion.roll(by, 1), window.motion, none).ids[row]
            for by in (-2, -1, 1, 2)
        ]
        assert sum(torch.equal(made.ids[row], ids) for ids in moved) == 1


@pytest.mark.slow
def test_cues_are_learned_from_the_sound(tmp_path):
    """Every clip beats where its audio code is below 4: known cues make that readable in the hidden state."""
    made = [TokenClip(c.audio, c.motion, c.domain, cues=(c.audio < 4).astype(np.uint8)) for c in clips(8)]
    training = settings(steps=60, batch=8, learning_rate=5e-3, warmup=5, cue_weight=1.0)
    train_generator(config(layers=1), training, made, tmp_path)
    rows = [json.loads(row)["cues"] for row in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert np.mean(rows[-5:]) < 0.3 * np.mean(rows[:5])


def test_other_settings_or_another_model_are_not_resumed(tmp_path):
    train_generator(config(), settings(steps=1), clips(), tmp_path)
    with pytest.raises(CheckpointError, match="settings"):
        train_generator(config(), settings(steps=2), clips(), tmp_path)
    with pytest.raises(CheckpointError, match="config"):
        train_generator(config(mlp=56), settings(steps=1), clips(), tmp_path)
    with pytest.raises(CheckpointError, match="depth_weights"):
        Trainer(config(), settings(depth_weights=(1.0,)))


def test_a_damaged_resume_file_is_named(tmp_path):
    (tmp_path / "resume.safetensors").write_bytes(b"half a file")
    with pytest.raises(CheckpointError, match="resume.safetensors is damaged"):
        Trainer(config(), settings()).resume(tmp_path)
