from functools import partial

import pytest
import torch
from tests.models.motion_tokens import dance, small_config
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.checkpoint import read_card
from echoavatar.errors import CheckpointError
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.models.tokenizer.losses import LossWeights
from echoavatar_lab.models.tokenizer.recipe import TokenizerTraining, continued
from echoavatar_lab.models.tokenizer.train import TokenizerTask, train_tokenizer
from echoavatar_lab.models.tokenizer.windows import clip_features
from echoavatar_lab.training import Loop

TRAINING = TokenizerTraining(
    steps=6, batch=4, frames=32, learning_rate=1e-3, warmup=2, log_every=1, evaluate_every=4, dropout=0.5
)
CLIPS = [dance(seed, 80) for seed in range(2)]


def test_training_learns_and_leaves_a_usable_checkpoint(tmp_path):
    training = TRAINING.model_copy(
        update={"steps": 30, "temperature": 0.0, "dropout": 0.0, "learning_rate": 5e-3, "log_every": 5}
    )
    train_tokenizer(small_config(), training, CLIPS, [dance(9, 64)], tmp_path, card={"licence": "Apache-2.0"})
    assert losses(tmp_path)[30] < 0.9 * losses(tmp_path)[5]
    card = read_card(tmp_path)
    assert card["licence"] == "Apache-2.0"
    assert card["scores"]["mpjpe_body_mm"] > 0
    assert BodyTokenizer.load(tmp_path).encode(torch.zeros(1, 8, 315)).shape == (1, 2, 3, 2)


def test_a_start_as_an_auto_encoder_fills_the_codebooks_at_the_switch():
    training = TRAINING.model_copy(update={"quantize_from": 1})
    loop = Loop(TokenizerTask(small_config(), training, CLIPS))
    books = loop.stage.tokenizer.tokenizers()["lower"].quantizer.books()
    assert loop.advance()["commitment"] == 0
    assert not books[0].ready
    assert loop.advance()["commitment"] > 0
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


@pytest.mark.parametrize("at", [1, 5])
def test_a_killed_run_goes_on_to_the_same_curve_to_the_bit(tmp_path, at):
    training = TRAINING.model_copy(update={"quantize_from": 2, "average": 0.5, "save_every": 2})
    check_resume(partial(train_tokenizer, small_config(), training, CLIPS, []), tmp_path, at=at)


def test_pieces_share_one_trajectory():
    """Four windows at once, or one after the other, noise on the choice of codes and dropout included."""

    def make(pieces):
        training = TRAINING.model_copy(update={"accumulation": pieces, "losses": LossWeights(travel=0.02)})
        return TokenizerTask(small_config(), training, CLIPS)

    books = [loop.stage.tokenizer.codebooks() for loop in check_pieces(make, 4, steps=6)]
    torch.testing.assert_close(*books, rtol=1e-3, atol=1e-4)


def test_a_state_of_other_sizes_is_refused(tmp_path):
    Loop(TokenizerTask(small_config(), TRAINING, CLIPS)).save(tmp_path)
    with pytest.raises(CheckpointError, match="another tokenizer config: parts"):
        Loop(TokenizerTask(small_config(width=24), TRAINING, CLIPS)).resume(tmp_path)
