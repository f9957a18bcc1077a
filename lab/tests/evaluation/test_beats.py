import numpy as np
import pytest
from lab.tests.evaluation.metrics.swings import swing

from echoavatar_lab.evaluation import beats
from echoavatar_lab.evaluation.metrics.gesture_alignment import gesture_beats


def test_chance_is_below_the_score_of_aligned_motion() -> None:
    periods = (0.9, 1.1, 1.3)
    events = [np.arange(1, 12) * period / 2 for period in periods]
    own, chance = beats.alignment_and_chance(events, [gesture_beats(swing(p)) for p in periods])
    assert own > 0.9
    assert chance < 0.6


def test_clips_without_events_are_left_out_of_both() -> None:
    """Two clips that share their beat, one without events: chance is what the two score with each other's."""
    events = [np.arange(1, 10) * 0.5, np.zeros(0), np.arange(1, 10) * 0.5]
    own, chance = beats.alignment_and_chance(events, [gesture_beats(swing(1.0))] * 3)
    assert own == pytest.approx(chance)
    assert own > 0.9
    assert np.isnan(beats.alignment_and_chance([np.zeros(0)], [[]])).all()


def test_speed_around_events_tells_strokes_from_rests() -> None:
    """A point that moves at 1 m/s for a sixth of a second before each event, and rests otherwise."""
    frames, events = np.arange(600), np.arange(2, 18, 1.0)
    moves = ((frames % 30) >= 25).astype(float) / 30
    positions = np.zeros((600, 1, 3))
    positions[:, 0, 0] = np.cumsum(moves)
    before, after = (beats.speed_around(positions, events, span) for span in ((-0.13, -0.05), (0.2, 0.5)))
    assert len(before) == 16
    assert before.mean() > 4
    assert after.max() < 0.1
