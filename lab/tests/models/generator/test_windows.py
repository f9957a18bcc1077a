"""Windows lie at chunk borders, audio beside its motion, and depend on seed and number alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from echoavatar.errors import MotionError
from echoavatar_lab.models.generator.windows import (
    TokenClip,
    WindowSampler,
    corrupt_hierarchically,
    corrupt_uniformly,
    shared_encoding,
)


def clip(chunks, offset=0):
    """Codes that say where they are: chunk c has audio and motion codes offset + c."""
    audio = np.repeat(np.arange(chunks), 20)[:, None].repeat(2, 1) + offset
    motion = (np.repeat(np.arange(chunks), 2)[:, None, None] + offset) * np.ones((1, 3, 2), int)
    return TokenClip(audio, motion, np.ones(2 * chunks, np.uint8))


def test_audio_and_motion_of_a_window_begin_at_the_same_chunk():
    window = WindowSampler([clip(9), clip(7, 100)], chunks=3).batch(5, 64)
    assert torch.equal(window.audio[:, ::20, 0], window.motion[:, ::2, 0, 0])
    assert torch.equal(window.audio[:, 59, 0], window.audio[:, 0, 0] + 2)


def test_every_window_is_drawn_and_none_crosses_clips():
    """Clips of 9 and 7 chunks have 7 + 5 windows of 3."""
    sampler = WindowSampler([clip(9), clip(7, 100), clip(2, 200)], chunks=3)
    begins = set(sampler.batch(0, 500).audio[:, 0, 0].tolist())
    assert len(sampler) == 12
    assert begins == {*range(7), *range(100, 105)}


def test_a_batch_depends_on_seed_and_number_alone():
    one, two, other = (WindowSampler([clip(50)], chunks=3, seed=seed) for seed in (1, 1, 2))
    one.batch(0, 4)
    assert torch.equal(one.batch(7, 9).audio, two.batch(7, 9).audio)
    assert not torch.equal(one.batch(7, 9).audio, other.batch(7, 9).audio)


def test_the_grid_covers_without_overlap():
    parts = WindowSampler([clip(9), clip(7, 100)], chunks=3).grid(2)
    assert torch.cat([p.audio[:, 0, 0] for p in parts]).tolist() == [0, 3, 6, 100, 103]


def test_a_token_file_comes_back(tmp_path):
    TokenClip(clip(4).audio, clip(4).motion, clip(4).domain, "test").save(tmp_path / "a.npz")
    back = TokenClip.load(tmp_path / "a.npz")
    assert np.array_equal(back.motion, clip(4).motion)
    assert back.split == "test"


def test_files_of_one_patience_tell_it_and_others_are_refused(tmp_path):
    TokenClip(clip(4).audio, clip(4).motion, clip(4).domain, patience=0.5).save(tmp_path / "a.npz")
    patient = TokenClip.load(tmp_path / "a.npz")
    assert shared_encoding([patient, patient])["patience"] == 0.5
    assert shared_encoding([]) == {}
    with pytest.raises(MotionError, match=r"patience \[0\.0, 0\.5\]"):
        shared_encoding([patient, clip(4)])


def test_whether_sound_was_leveled_travels_with_the_codes(tmp_path) -> None:
    raw = replace(clip(4), is_leveled=False)
    raw.save(tmp_path / "raw.npz")
    assert not TokenClip.load(tmp_path / "raw.npz").is_leveled
    assert not shared_encoding([raw, raw])["is_leveled"]
    with pytest.raises(MotionError, match="--no-level"):
        shared_encoding([raw, clip(4)])


def test_ragged_ends_are_cut_to_whole_chunks():
    ragged = TokenClip(clip(4).audio[:75], clip(4).motion[:7], clip(4).domain)
    assert (ragged.chunks, len(ragged.audio), len(ragged.domain)) == (3, 60, 6)


def test_bad_files_and_short_clips_are_named(tmp_path):
    (tmp_path / "bad.npz").write_text("no")
    with pytest.raises(MotionError, match="bad.npz"):
        TokenClip.load(tmp_path / "bad.npz")
    with pytest.raises(MotionError, match="24 chunks"):
        WindowSampler([clip(5)], chunks=24)


def test_sound_heard_ahead_lies_beside_earlier_motion():
    """Two chunks early: beside the motion of chunk c lie sound and cues of chunk c + 2, and the last two chunks go."""
    cues = np.repeat(np.arange(9, dtype=np.uint8), 20)[:, None].repeat(2, 1)
    early = TokenClip(clip(9).audio, clip(9).motion, clip(9).domain, cues=cues).heard_ahead(2)
    assert early.chunks == 7
    assert np.array_equal(early.audio[::20, 0], early.motion[::2, 0, 0] + 2)
    assert np.array_equal(early.cues[:, 0], early.audio[:, 0])
    assert np.array_equal(clip(9).heard_ahead(0).audio, clip(9).audio)


OUTSIDE = 1_000_000  # codes that noise never draws, so that every replacement shows


def corrupted(rate, *, steps=20, rows=2, layers=4, seed=0):
    codes = torch.full((rows, steps, 3, layers), OUTSIDE)
    random = torch.Generator().manual_seed(seed)
    return corrupt_hierarchically(codes, rate, codebook=512, generator=random) != OUTSIDE


@given(st.integers(0, 10), st.integers(1, 30), st.integers(0, 99))
def test_exactly_floor_of_rate_times_steps_are_touched_in_every_part(tenths, steps, seed):
    """|S| = floor(rho T); a touched step always loses its last layer."""
    touched = corrupted(tenths / 10, steps=steps, seed=seed)
    assert torch.equal(touched[..., -1].sum(1), torch.full((2, 3), tenths * steps // 10))


def test_all_layers_behind_the_first_corrupted_one_are_corrupted():
    touched = corrupted(0.7, steps=100).int()
    assert bool((touched.diff(dim=-1) >= 0).all())


def test_the_first_corrupted_layer_is_uniform():
    """With rate 1 and Q = 4 layer q is touched with probability (q + 1) / 4; 6,000 draws, 4 sigma = 0.026."""
    share = corrupted(1.0, steps=1000).float().mean(dim=(0, 1, 2))
    torch.testing.assert_close(share, torch.tensor([0.25, 0.5, 0.75, 1.0]), atol=0.026, rtol=0)


def test_parts_are_corrupted_independently():
    touched = corrupted(0.5, steps=200)[..., -1]
    assert not torch.equal(touched[:, :, 0], touched[:, :, 1])


def test_each_row_may_have_its_own_rate():
    touched = corrupted(torch.tensor([0.0, 1.0]))
    assert not touched[0].any()
    assert bool(touched[1, ..., -1].all())


def test_uniform_corruption_hits_every_layer_at_its_rate_with_every_code():
    codes = torch.full((4, 500, 3, 4), OUTSIDE)
    out = corrupt_uniformly(codes, 0.3, codebook=8, generator=torch.Generator().manual_seed(1))
    share = (out != OUTSIDE).float().mean(dim=(0, 1, 2))
    torch.testing.assert_close(share, torch.full((4,), 0.3), atol=0.025, rtol=0)
    assert set(out.unique().tolist()) == {*range(8), OUTSIDE}


def test_the_same_seed_corrupts_the_same_codes():
    codes = torch.arange(240).view(1, 20, 3, 4)
    one, two = (
        corrupt_hierarchically(codes, 0.5, codebook=9, generator=torch.Generator().manual_seed(5)) for _ in range(2)
    )
    assert torch.equal(one, two)
