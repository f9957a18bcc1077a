import json

import pytest
import torch
from tests.tokenizer.fixtures import dance, small_config

from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError
from echoavatar.kinematics import HUMANOID
from echoavatar.tokenizer import BodyTokenizer
from echoavatar.tokenizer.train import (
    TokenizerRun,
    TokenizerTraining,
    bundle_recipe,
    continued,
    train_tokenizer,
)
from echoavatar.tokenizer.training_state import STATE_NAME, load_training, save_training
from echoavatar.tokenizer.windows import clip_features

TRAINING = TokenizerTraining(
    steps=6, batch=4, frames=32, learning_rate=1e-3, warmup=2, log_every=1, evaluate_every=4, dropout=0.5
)
CLIPS = [dance(seed, 80) for seed in range(2)]


def losses(folder):
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return {line["step"]: line["loss"] for line in lines if "loss" in line}


def test_the_rate_warms_up_and_drops_in_steps():
    """Peak 1e-3: half of it after one of two warm-up steps; a tenth after 50 %, a hundredth after 80 % of ten steps."""
    training = TRAINING.model_copy(update={"steps": 10})
    rates = [training.rate_at(step) for step in (0, 1, 4, 5, 8)]
    assert rates == pytest.approx([5e-4, 1e-3, 1e-3, 1e-4, 1e-5])


def test_training_learns_and_leaves_a_usable_checkpoint(tmp_path):
    training = TRAINING.model_copy(
        update={"steps": 30, "temperature": 0.0, "dropout": 0.0, "learning_rate": 5e-3, "log_every": 5}
    )
    train_tokenizer(small_config(), training, CLIPS, [dance(9, 64)], tmp_path, card={"licence": "Apache-2.0"})
    curve = losses(tmp_path)
    assert sum(curve[30].values()) < 0.9 * sum(curve[5].values())
    card = read_card(tmp_path)
    assert card["licence"] == "Apache-2.0"
    assert card["scores"]["mpjpe_body_mm"] > 0
    assert BodyTokenizer.load(tmp_path).encode(torch.zeros(1, 8, 315)).shape == (1, 2, 3, 2)


def test_a_start_as_an_auto_encoder_fills_the_codebooks_at_the_switch():
    training = TRAINING.model_copy(update={"quantize_from": 1})
    run = TokenizerRun(small_config(), training, CLIPS)
    books = run.tokenizer.tokenizers()["lower"].quantizer.books()
    assert run.advance()["commitment"] == 0
    assert not books[0].ready
    assert run.advance()["commitment"] > 0
    assert books[0].ready


def test_a_run_may_begin_with_a_trained_tokenizer(tmp_path):
    """One step at the lower rate changes little: codes stay what they were, and the statistics too."""
    trained = train_tokenizer(small_config(), TRAINING, CLIPS, [], tmp_path / "first")
    training = continued(TRAINING).model_copy(update={"steps": 1})
    other = [dance(seed, 80) for seed in (5, 6)]
    after = train_tokenizer(small_config(), training, other, [], tmp_path / "second", start=trained)
    torch.testing.assert_close(after.mean, trained.mean)
    x = clip_features(HUMANOID, CLIPS[0])[None]
    agree = (after.eval().encode(x) == trained.eval().encode(x)).float().mean()
    assert agree > 0.9
    assert training.learning_rate < TRAINING.learning_rate


def test_a_killed_run_goes_on_to_the_same_loss_curve(tmp_path):
    """Stopped after step 3 (metrics of step 4 were already written) and started again: every later number is equal."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    train_tokenizer(small_config(), TRAINING, CLIPS, [], whole)
    killed.mkdir()
    run = TokenizerRun(small_config(), TRAINING, CLIPS)
    with (killed / "metrics.jsonl").open("w") as file:
        for _ in range(4):
            if run.step == 3:
                save_training(killed, run.tokenizer, run.optimizer, run.generator, run.step)
            file.write(json.dumps({"step": run.step + 1, "loss": run.advance()}) + "\n")
    train_tokenizer(small_config(), TRAINING, CLIPS, [], killed)
    assert losses(killed) == losses(whole)
    ours, theirs = BodyTokenizer.load(killed).state_dict(), BodyTokenizer.load(whole).state_dict()
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)


def test_a_state_of_other_sizes_is_refused(tmp_path):
    run = TokenizerRun(small_config(), TRAINING, CLIPS)
    save_training(tmp_path, run.tokenizer, run.optimizer, run.generator, 0)
    other = TokenizerRun(small_config(width=24), TRAINING, CLIPS)
    with pytest.raises(CheckpointError, match="other sizes"):
        load_training(tmp_path, other.tokenizer, other.optimizer, other.generator, other)


def test_a_damaged_state_is_named(tmp_path):
    (tmp_path / STATE_NAME).write_bytes(b"not a state")
    run = TokenizerRun(small_config(), TRAINING, CLIPS)
    with pytest.raises(CheckpointError, match="damaged"):
        load_training(tmp_path, run.tokenizer, run.optimizer, run.generator, run)


def test_the_bundle_recipe_fits_the_budget():
    """Three tokenizers in half precision stay under 14 MB."""
    config, training = bundle_recipe(HUMANOID, 1000)
    tensors = BodyTokenizer(config).state_dict().values()
    assert sum(tensor.numel() * 2 for tensor in tensors) < 14e6
    assert training.steps == 1000
    assert config.layers == 4
