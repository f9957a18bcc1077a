import copy

import pytest
import torch
from tests.models.motion_tokens import dance, small_body
from tests.models.runs import check_pieces, check_resume, losses

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.stored import read_card
from echoavatar_lab.data.clip import mirror_features
from echoavatar_lab.models.codebook_training import steady_codes
from echoavatar_lab.models.tokenizer.decoder_train import DecoderTask, DecoderTraining
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.models.tokenizer.train import clip_features
from echoavatar_lab.training import train

TRAINING = DecoderTraining(
    steps=30, batch=4, tokens=8, unheard=2, learning_rate=5e-3, warmup=2, log_every=1, evaluate_every=0
)
CLIPS = [dance(seed, 96) for seed in range(2)]


def test_the_decoder_learns_and_codes_keep_their_meaning(tmp_path):
    start = small_body()
    before = copy.deepcopy(start.state_dict())
    train(DecoderTask(start, TRAINING, CLIPS, tests=[dance(9, 64)], card={"licence": "Apache-2.0"}), tmp_path)
    curve = list(losses(tmp_path).values())
    assert sum(curve[-5:]) < 0.8 * sum(curve[:5])
    assert all(torch.equal(value, start.state_dict()[key]) for key, value in before.items())
    after = BodyTokenizer.load(tmp_path)
    x = clip_features(HUMANOID, CLIPS[0])[None]
    codes = steady_codes(start, x, 0.4)
    assert (steady_codes(after, x, 0.4) == codes).float().mean() > 0.99  # saved in half precision
    assert not torch.allclose(after.decode(codes), start.decode(codes), atol=1e-3)
    assert read_card(tmp_path)["scores"]["mpjpe_body_mm"] > 0


def test_windows_are_cut_from_codes_of_whole_clips():
    stage = DecoderTask(small_body(), TRAINING, CLIPS)
    batch = stage.draw(3)
    whole = [clip_features(HUMANOID, clip) for clip in CLIPS]
    whole += [mirror_features(HUMANOID, features) for features in whole]
    for features, codes in zip(batch.features, batch.codes, strict=True):
        found = [
            (clip, first)
            for clip in whole
            for first in range(len(clip) // 4 - 7)
            if torch.allclose(clip[4 * first : 4 * first + 32], features, atol=1e-6)
        ]
        ((clip, first),) = found
        assert torch.equal(steady_codes(stage.tokenizer, clip[None], 0.4)[0, first : first + 8], codes)


def test_what_comes_first_in_a_window_costs_nothing():
    stage = DecoderTask(small_body(), TRAINING, CLIPS)
    batch = stage.draw(0)
    other = batch.features.clone()
    other[:, :8] += 1.0
    assert torch.equal(stage.loss(batch, 0).total, stage.loss(batch._replace(features=other), 0).total)


def test_a_run_that_was_stopped_goes_on_to_the_same_curve(tmp_path):
    short = TRAINING.model_copy(update={"steps": 6, "save_every": 2})
    check_resume(
        lambda folder, **how: train(DecoderTask(small_body(), short, CLIPS), folder, **how).tokenizer, tmp_path, at=3
    )


def test_pieces_share_one_trajectory():
    plain = TRAINING.losses.model_copy(update={"planted": 0.0})

    def make(pieces):
        return DecoderTask(small_body(), TRAINING.model_copy(update={"accumulation": pieces, "losses": plain}), CLIPS)

    check_pieces(make, 4)


def test_clips_shorter_than_a_window_are_refused():
    with pytest.raises(MotionError, match="no clip has 8 tokens"):
        DecoderTask(small_body(), TRAINING, [dance(0, 28)])
