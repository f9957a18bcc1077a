import numpy as np
import pytest
from lab.tests.evaluation.metrics.swings import swing

from echoavatar.errors import MotionError
from echoavatar_lab.evaluation.metrics.gesture_alignment import (
    GESTURE_RULES,
    GestureForm,
    central_speed,
    gesture_alignment,
    gesture_beat_frames,
    gesture_beats,
    mean_speeds,
)

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
