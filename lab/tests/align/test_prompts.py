"""Prompts are what they claim, by clip and by time."""

import numpy as np
import pytest
from lab.tests.align.tuning_fakes import clips
from tests.models.generator.tiny import LAYOUT

from echoavatar.errors import MotionError
from echoavatar_lab.align.prompts import PromptSampler, batch_of, cue_times, read_token_clips
from echoavatar_lab.models.generator.sequences import compact_layout


def test_a_prompt_holds_the_clip_from_where_it_says():
    mine = clips()
    book = PromptSampler(mine, past=2, length=3)
    prompt = book.cut("clip1", 1)
    np.testing.assert_array_equal(prompt.audio, mine["clip1"].audio[20:120])
    np.testing.assert_array_equal(prompt.past, mine["clip1"].motion[2:6])
    np.testing.assert_array_equal(prompt.truth, mine["clip1"].motion[6:12])
    assert len(book) == 3 * 2  # of 6 chunks, windows of 5 begin at 0 or 1
    assert batch_of([prompt, book.cut("clip0", 0)]).audio.shape == (2, 100, 2)


def test_events_are_told_in_seconds_from_the_first_new_frame():
    """Cues begin at audio frames 30, 67 and 104; 3 chunks after the clip's beginning are frame 60."""
    mine = clips()
    np.testing.assert_allclose(cue_times(mine["clip0"], 0), np.array([30, 67, 104]) / 75)
    prompt = PromptSampler(mine, past=2, length=3).cut("clip0", 1)
    np.testing.assert_allclose(prompt.beats, np.array([7, 44]) / 75)
    assert len(prompt.stresses) == 0


def test_only_prompts_with_enough_events_are_drawn():
    mine = clips()
    assert len(PromptSampler(mine, past=1, length=1, fewest_events=1)) < len(PromptSampler(mine, past=1, length=1))
    for prompt in PromptSampler(mine, past=1, length=1, fewest_events=1).spread(50):
        assert len(prompt.beats) >= 1
    with pytest.raises(MotionError, match=r"no clip holds a prompt of 1 \+ 2 chunks with 9 beats or stresses"):
        PromptSampler(mine, past=1, length=2, fewest_events=9)


def test_draws_depend_on_seed_and_number_alone():
    book = PromptSampler(clips(), past=1, length=1, seed=3)
    names = [[(p.clip, p.start) for p in book.draw(number, 5)] for number in (4, 5, 4)]
    assert names[0] == names[2] != names[1]


def test_unknown_clips_and_places_are_named():
    book = PromptSampler(clips(), past=2, length=3)
    with pytest.raises(MotionError, match="no clip 'other' among the 3 token files"):
        book.cut("other", 0)
    with pytest.raises(MotionError, match="has 6 chunks: no prompt of 2 \\+ 3 begins at 2"):
        book.cut("clip0", 2)


def test_token_files_of_another_vocabulary_are_named(tmp_path):
    with pytest.raises(MotionError, match="holds no token files"):
        read_token_clips(tmp_path)
    clips()["clip0"].save(tmp_path / "one.npz")
    assert set(read_token_clips(tmp_path, LAYOUT)) == {"one"}
    small = compact_layout(audio_codes=16, motion_layers=2, motion_codes=4)
    with pytest.raises(MotionError, match=r"one\.npz has 2 motion layers, motion codes below 8"):
        read_token_clips(tmp_path, small)


def test_generated_motion_is_not_used_as_truth(tmp_path):
    mine = clips()
    object.__setattr__(mine["clip1"], "has_truth", False)
    for name, clip in mine.items():
        clip.save(tmp_path / f"{name}.npz")
    assert set(read_token_clips(tmp_path)) == {"clip0", "clip1", "clip2"}
    assert set(read_token_clips(tmp_path, needs_truth=True)) == {"clip0", "clip2"}
    (tmp_path / "clip0.npz").unlink()
    (tmp_path / "clip2.npz").unlink()
    with pytest.raises(MotionError, match="only motion that a generator made"):
        read_token_clips(tmp_path, needs_truth=True)
