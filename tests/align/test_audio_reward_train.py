"""A small pair of encoders learns which motion goes with which sound, and finds it among unseen windows."""

import numpy as np
import pytest
import torch

from echoavatar.align.audio_reward import AudioMotion
from echoavatar.align.audio_reward_train import (
    AudioRewardTraining,
    Pairs,
    embed,
    retrieval_table,
    train_audio_reward,
)
from echoavatar.errors import MotionError
from echoavatar.generator import TokenClip


def told(count: int, seed: int) -> dict[str, TokenClip]:
    """Motion that spells out the loudest sound of each token: code = sound code // 2."""
    random, made = np.random.default_rng(seed), {}
    for k in range(count):
        sound = np.repeat(random.integers(16, size=(32, 1)), 10, axis=0).repeat(2, axis=1)
        motion = (sound[::10, :1] // 2)[:, :, None].repeat(3, axis=1).repeat(2, axis=2)
        made[f"clip{k}"] = TokenClip(sound, motion, np.full(32, 2, np.uint8))
    return made


def test_it_finds_motion_by_sound_and_sound_by_motion_among_windows_it_never_saw(tmp_path):
    torch.manual_seed(0)
    model = AudioMotion.over(
        torch.randn(2, 16, 8), torch.randn(3, 2, 8, 4), width=32, layers=1, sound_layers=1, heads=2, size=96
    )
    training = AudioRewardTraining(steps=80, batch=20, each=1, learning_rate=3e-3)
    model = train_audio_reward(model, Pairs(told(30, 0), chunks=4), tmp_path, training)
    table = retrieval_table(*embed(model, Pairs(told(12, 1), chunks=4)))
    assert len(table) == 6  # two ways among all, in a gallery, in batches of 32
    for row in table.values():
        assert row["R@1"] > 8 * row["chance"]["R@1"]
    assert (tmp_path / "model.safetensors").exists()


def test_mirrored_clips_share_their_segments():
    clips = told(2, 0)
    clips["clip0.mirror"] = clips["clip0"]
    pairs = Pairs(clips, chunks=16)
    _, _, segments = pairs.draw(0, 64, 0)
    assert len(set(segments.tolist())) == 2
    assert pairs.grid()[0].shape == (2, 320, 2)  # mirrored windows are not asked for


def test_clips_that_are_too_short_are_refused():
    with pytest.raises(MotionError, match="no clip is as long as a window of 20 chunks"):
        Pairs(told(2, 0), chunks=20)
