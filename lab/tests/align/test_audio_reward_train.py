"""A small pair of encoders learns which motion goes with which sound, and finds it among unseen windows."""

import numpy as np
import pytest
import torch

from echoavatar.errors import MotionError
from echoavatar_lab.align.audio_reward import AudioMotion
from echoavatar_lab.align.audio_reward_train import (
    AudioMotionWindows,
    AudioRewardTask,
    AudioRewardTraining,
    embed,
    retrieval_table,
    retrieval_tables,
)
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.training import train


def told(count: int, seed: int) -> dict[str, TokenClip]:
    """Motion that spells out the loudest sound of each token: code = sound code // 2."""
    random, made = np.random.default_rng(seed), {}
    for k in range(count):
        sound = np.repeat(random.integers(16, size=(32, 1)), 10, axis=0).repeat(2, axis=1)
        motion = (sound[::10, :1] // 2)[:, :, None].repeat(3, axis=1).repeat(2, axis=2)
        made[f"clip{k}"] = TokenClip(sound, motion, np.full(32, 2, np.uint8))
    return made


def small(width: int) -> AudioMotion:
    torch.manual_seed(0)
    books, sizes = (torch.randn(2, 16, 8), torch.randn(3, 2, 8, 4)), {"layers": 1, "heads": 2}
    return AudioMotion.from_codebooks(*books, width=width, size=96, **sizes)


def test_it_finds_motion_by_sound_and_sound_by_motion_among_windows_it_never_saw(tmp_path):
    training = AudioRewardTraining(steps=80, batch=20, each=1, learning_rate=3e-3)
    model = train(AudioRewardTask(small(width=32), AudioMotionWindows(told(30, 0), chunks=4), training), tmp_path).model
    table = retrieval_table(*embed(model, AudioMotionWindows(told(12, 1), chunks=4)))
    assert len(table) == 6  # two ways among all, in a gallery, in batches of 32
    for row in table.values():
        assert row["R@1"] > 8 * row["chance"]["R@1"]
    assert (tmp_path / "model.safetensors").exists()


def test_mirrored_clips_share_their_segments():
    clips = told(2, 0)
    clips["clip0.mirror"] = clips["clip0"]
    pairs = AudioMotionWindows(clips, chunks=16)
    _, _, segments = pairs.draw(0, 64, 0)
    assert len(set(segments.tolist())) == 2
    assert pairs.grid()[0].shape == (2, 320, 2)  # mirrored windows are not asked for


def test_windows_of_one_clip_lie_side_by_side_in_a_batch():
    pairs = AudioMotionWindows(told(6, 0), chunks=4)
    segments = pairs.draw(3, 12, 0, each=3).segments
    clip, start = segments // 100_000, segments % 100_000
    for k in range(0, 12, 3):
        assert len(set(clip[k : k + 3].tolist())) == 1
        apart = start[k : k + 3].sort().values.diff()
        assert (apart >= 4).all()
    assert torch.equal(segments, pairs.draw(3, 12, 0, each=3).segments)


def test_retrieval_is_also_measured_within_each_domain():
    """Speech and music cannot be mistaken for each other when only one of them is asked."""
    clips = told(10, 0)
    for k in range(4):
        clips[f"clip{k}"].domain[:] = 1
    pairs = AudioMotionWindows(clips, chunks=2)
    tables = retrieval_tables(small(width=16).eval(), pairs)
    galleries = {name: table["audio to motion, all"]["gallery"] for name, table in tables.items()}
    assert galleries == {"everything": 80, "speech": 32, "music": 48}
    with pytest.raises(MotionError, match="no window of 2 chunks is mostly silence"):
        pairs.grid(0)


def test_clips_that_are_too_short_are_refused():
    with pytest.raises(MotionError, match="no clip is as long as a window of 20 chunks"):
        AudioMotionWindows(told(2, 0), chunks=20)
