import numpy as np
import pytest

from echoavatar.evaluation import beats


def swing(period_s: float, seconds: float = 20.0) -> np.ndarray:
    """One joint swinging so that it stands still every half period."""
    t = np.arange(int(seconds * 30)) / 30
    place = np.zeros((len(t), 1, 3))
    place[:, 0, 0] = np.cos(2 * np.pi * t / period_s)
    return place


def test_a_pendulum_hits_its_own_turning_points() -> None:
    """Period 1 s: the joint stands still at 0.5, 1.0, 1.5, ... s."""
    events = np.arange(1, 19) * 0.5
    found = beats.speech_motion_beats(swing(1.0))
    assert beats.alignment(events, found) > 0.95
    assert beats.alignment(events + 0.25, found) < 0.05


def test_deceleration_peaks_a_quarter_swing_after_top_speed() -> None:
    """Speed |sin| brakes hardest where it reaches zero, at every half second."""
    found = beats.dance_motion_beats(swing(1.0))[0]
    assert np.abs(found[:, None] - np.arange(41) * 0.5).min(1).max() < 0.07


def test_score_follows_the_formula() -> None:
    """One event, one beat 0.06 s away, sigma 0.06: exp(-1/2)."""
    assert beats.alignment(np.array([1.0]), [np.array([1.06])]) == pytest.approx(np.exp(-0.5))


def test_no_motion_scores_zero_and_no_events_score_nothing() -> None:
    assert beats.alignment(np.array([1.0]), [np.zeros(0)]) == 0
    assert np.isnan(beats.alignment(np.zeros(0), [np.array([1.0])]))


def test_chance_is_below_the_score_of_aligned_motion() -> None:
    periods = (0.9, 1.1, 1.3)
    events = [np.arange(1, 12) * period / 2 for period in periods]
    own, chance = beats.alignment_and_chance(events, [beats.speech_motion_beats(swing(p)) for p in periods])
    assert own > 0.9
    assert chance < 0.6


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
