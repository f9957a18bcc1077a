import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from lab.tests.evaluation.metrics.swings import swing

from echoavatar.errors import MotionError
from echoavatar_lab.evaluation.metrics.beat_alignment import (
    EMAGE_RATE_HZ,
    GESTURE_RULES,
    DanceForm,
    GestureForm,
    central_speed,
    chance_per_clip,
    dance_alignment,
    dance_beats,
    gesture_alignment,
    gesture_beat_frames,
    gesture_beats,
    hit_rate,
    mean_hit_rate,
    mean_speeds,
    music_beats,
    overlapping,
    shuffled_scores,
    speech_onsets,
)


def clicks(every_s: float, rate: int, seconds: float = 10.0) -> np.ndarray:
    """Short decaying tones."""
    audio = np.zeros(int(seconds * rate), np.float32)
    t = np.arange(int(0.08 * rate)) / rate
    tone = (np.sin(2 * np.pi * 880 * t) * np.exp(-t * 50)).astype(np.float32)
    for start in np.arange(0.5, seconds - 0.2, every_s):
        at = int(start * rate)
        audio[at : at + len(tone)] = tone
    return audio


def test_onsets_are_where_tones_begin() -> None:
    """To one hop of 32 ms."""
    found = speech_onsets(clicks(0.7, EMAGE_RATE_HZ), EMAGE_RATE_HZ)
    true = np.arange(0.5, 9.8, 0.7)
    assert np.abs(true[:, None] - found).min(1).max() < 0.05


def test_beats_are_as_far_apart_as_the_clicks() -> None:
    found = music_beats(clicks(0.5, 24_000), 24_000)
    assert np.median(np.diff(found)) == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
def test_a_second_process_that_reads_the_cache_finds_the_same_beats(tmp_path: Path) -> None:
    """Three at once on an empty cache, and one more after them: numba's race used to crash the last."""
    script = (
        "import numpy as np; from echoavatar_lab.evaluation.metrics.beat_alignment import music_beats;"
        "x = np.zeros(192_000, np.float32); x[::12_000] = 1; print(len(music_beats(x, 24_000)))"
    )
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def begin() -> "subprocess.Popen[str]":
        return subprocess.Popen([sys.executable, "-c", script], stdout=-1, text=True, env=surroundings)

    told = [process.communicate(timeout=300)[0] for process in [begin() for _ in range(3)]]
    last = begin()
    assert {*told, last.communicate(timeout=300)[0]} == {told[0]}
    assert int(told[0]) > 10
    assert last.returncode == 0


@pytest.mark.slow
def test_a_user_without_a_home_finds_beats(tmp_path: Path) -> None:
    script = (
        "import os, pwd; os.environ.pop('HOME', None); pwd.getpwuid = {}.__getitem__\n"
        "import numpy as np; from echoavatar_lab.evaluation.metrics.beat_alignment import music_beats\n"
        "x = np.zeros(192_000, np.float32); x[::12_000] = 1; print(len(music_beats(x, 24_000)))"
    )
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "XDG_CACHE_HOME": "", "HOME": "/"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=surroundings)
    assert int(done.stdout) > 10, done.stderr


def test_score_follows_the_formula() -> None:
    """One event, one beat a sigma away: exp(-1/2); a second event on the beat: the mean."""
    assert hit_rate(np.array([1.0]), np.array([1.06]), 0.06) == pytest.approx(np.exp(-0.5))
    assert hit_rate(np.array([1.0, 1.06]), np.array([1.06]), 0.06) == pytest.approx((1 + np.exp(-0.5)) / 2)


def test_the_nearest_beat_counts_and_only_events_ask() -> None:
    """A second beat far from everything changes nothing; a second event would."""
    assert hit_rate(np.array([1.0]), np.array([1.0, 9.0]), 0.06) == 1
    assert hit_rate(np.array([1.0, 9.0]), np.array([1.0]), 0.06) == pytest.approx(0.5)


def test_no_motion_scores_zero_and_no_events_score_nothing() -> None:
    assert hit_rate(np.array([1.0]), np.zeros(0), 0.06) == 0
    assert np.isnan(hit_rate(np.zeros(0), np.array([1.0]), 0.06))


def test_a_joint_that_never_rests_pulls_the_mean_down() -> None:
    assert mean_hit_rate(np.array([1.0]), [np.array([1.0]), np.zeros(0)], 0.06) == 0.5


def test_other_clips_events_count_only_where_ours_lie() -> None:
    ours = np.array([2.0, 5.0])
    assert overlapping(np.array([1.0, 2.0, 3.0, 6.0]), ours).tolist() == [2.0, 3.0]
    assert overlapping(ours, np.zeros(0)).tolist() == []


def test_each_motion_meets_every_other_sound_once_and_never_its_own() -> None:
    met: list[tuple[int, int]] = []

    def score(motion: int, sound: int) -> float:
        met.append((motion, sound))
        return 0.0

    assert shuffled_scores(score, 4).shape == (4, 3)
    assert sorted(met) == [(i, j) for i in range(4) for j in range(4) if i != j]


def test_fewer_partners_are_drawn_by_the_seed() -> None:
    scores = [shuffled_scores(lambda i, j: 10 * i + j, 9, partners=3, seed=seed) for seed in (1, 1, 2)]
    assert scores[0].shape == (9, 3)
    assert all(len(set(row)) == 3 for row in scores[0])
    assert all(int(value) % 10 != i for i, row in enumerate(scores[0]) for value in row)
    np.testing.assert_array_equal(scores[0], scores[1])
    assert not np.array_equal(scores[0], scores[2])


def test_clips_that_cannot_be_scored_are_left_out() -> None:
    scores = shuffled_scores(lambda i, j: float("nan") if j == 0 else float(j), 3)
    np.testing.assert_allclose(chance_per_clip(scores), [1.5, 2.0, 1.0])
    assert np.isnan(chance_per_clip(shuffled_scores(lambda i, j: 1.0, 1))).all()


TURNS = np.arange(1, 19) * 0.5  # where a swing of one second stands still


@pytest.mark.parametrize("form", ["paper", "sharp"])
def test_a_pendulum_hits_its_own_turning_points(form: GestureForm) -> None:
    found = gesture_beats(swing(1.0), form)
    assert gesture_alignment(found, TURNS, form) > 0.95
    assert gesture_alignment(found, TURNS + 0.25, form) < (0.8 if form == "paper" else 0.05)


@pytest.mark.parametrize("form", ["emage", "evaltools", "fixed"])
def test_a_beat_must_be_slow_but_above_a_share_of_the_mean(form: GestureForm) -> None:
    """Speed |sin| has minima of zero, under any threshold; 1.5 + cos(2 pi t) has minima a third of its mean 1.5."""
    speed = mean_speeds(swing(1.0))
    assert all(len(own) == 0 for own in gesture_beats(swing(1.0), "fixed", speed))
    t = np.arange(600) / 30
    moving = np.zeros((600, 1, 3))
    moving[:, 0, 0] = np.cumsum(1.5 + np.cos(2 * np.pi * t + 0.07)) / 30
    found = gesture_beats(moving, form, mean_speeds(moving))[0]
    assert len(found) == 16
    assert np.abs(found % 1 - 0.5).max() < 0.05


@pytest.mark.parametrize(("apart", "found"), [(6, 1), (7, 1), (8, 2)])
def test_of_two_minima_within_seven_frames_the_lower_is_a_beat(apart: int, found: int) -> None:
    """A joint slows down twice in 20 s, to 0.6 and to 0.5 of its pace, for two frames each."""
    pace = np.ones(600)
    pace[300:302], pace[300 + apart : 302 + apart] = 0.6, 0.5
    moving = np.zeros((600, 1, 3))
    moving[:, 0, 0] = np.cumsum(pace) / 30
    (beats,) = gesture_beats(moving, "fixed", mean_speeds(moving))
    assert len(beats) == found


def test_the_index_quirk_tests_the_threshold_60_frames_too_early() -> None:
    """A joint slow for its first 10 s: `fixed` finds its late minima, `emage` loses the first two seconds of them."""
    t = np.arange(600) / 30
    pace = np.where(t < 10, 0.02, 1.0) * (1.5 + np.cos(2 * np.pi * t + 0.07))
    moving = np.zeros((600, 1, 3))
    moving[:, 0, 0] = np.cumsum(pace) / 30
    speed = mean_speeds(moving)
    fixed, quirky = (gesture_beats(moving, form, speed)[0] for form in ("fixed", "emage"))
    assert fixed.min() == pytest.approx(8.5, abs=0.1)  # 10.5 s of the clip, 2 s cut off
    assert quirky.min() == pytest.approx(10.5, abs=0.1)
    assert set(quirky) < set(fixed)


def test_speed_is_that_of_the_central_difference() -> None:
    """0.1 m a frame is 3 m/s, at the ends too."""
    line = np.zeros((5, 1, 3))
    line[:, 0, 1] = np.arange(5) * 0.1
    np.testing.assert_allclose(central_speed(line), 3.0)


def test_missing_speeds_and_short_clips_are_refused() -> None:
    with pytest.raises(MotionError, match="mean speeds"):
        gesture_beats(swing(1.0), "emage")
    with pytest.raises(MotionError, match="longer clips"):
        gesture_beat_frames(swing(1.0, 4.0), GESTURE_RULES["emage"], np.ones(1))


RESTS = np.arange(41) * 0.5


@pytest.mark.parametrize("form", get_args(DanceForm))
def test_beats_of_a_pendulum_are_where_it_stands_still(form: DanceForm) -> None:
    """Speed |sin| is least, and brakes hardest, at every half second; smoothing over 5 frames keeps both."""
    found = dance_beats(swing(1.0), form)
    assert len(found) > 30
    assert np.abs(found[:, None] - RESTS).min(1).max() < 0.07


def test_events_are_compared_in_the_direction_of_the_form() -> None:
    """Four clicks, a dancer on one of them: AIST++ is content, the others find three clicks unanswered."""
    music, motion = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0])
    assert dance_alignment(motion, music, "aist") == 1
    for form in ("paper", "bailando", "sharp"):
        assert dance_alignment(motion, music, form) == pytest.approx(0.25, abs=1e-6)


def test_sigma_in_frames_is_wider_at_a_lower_rate() -> None:
    """A tenth of a second is 6 frames at 60 fps, 3 at 30: exp(-2) and exp(-1/2). In seconds the rate plays no part."""
    music, motion = np.array([1.0]), np.array([1.1])
    for fps, expected in ((60, np.exp(-2)), (30, np.exp(-0.5))):
        assert dance_alignment(motion, music, "bailando", fps=fps) == pytest.approx(expected)
    assert dance_alignment(motion, music, "sharp", fps=60) == dance_alignment(motion, music, "sharp", fps=30)
