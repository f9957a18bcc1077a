import numpy as np
import pytest

from echoavatar.server.sinks.clock import FollowingClock
from echoavatar.timing import SAMPLE_RATE_HZ as RATE


def followed(told, read_hz: float = 60.0, seconds: float = 4.0) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Readings, in seconds, of a clock that follows reports at 50 Hz."""
    clock, readings, next_told = FollowingClock(), [], 0.0
    for now in np.arange(0, seconds, 1 / read_hz):
        while next_told <= now:
            clock.tell(told(next_told) * RATE, next_told)
            next_told += 0.02
        readings.append(clock.read(now))
    return np.array(readings) / RATE


def test_without_a_report_there_is_no_reading() -> None:
    assert FollowingClock().read(1.0) is None


def test_an_uneven_clock_is_followed_evenly() -> None:
    noise = np.random.default_rng(0)
    readings = followed(lambda now: now + noise.uniform(-0.015, 0.015))
    speed = np.diff(readings) * 60
    assert np.abs(readings - np.arange(len(readings)) / 60).max() < 0.03
    assert speed.min() > 0.7
    assert speed.max() < 1.3


def test_the_clock_stops_with_the_other_one_and_never_runs_backwards() -> None:
    readings = followed(lambda now: min(now, 2.0))
    assert (np.diff(readings) >= 0).all()
    assert readings[-1] - readings[-30] < 0.002
    assert abs(readings[-1] - 2.0) < 0.25


def test_a_jump_is_made_at_once_in_both_directions() -> None:
    for to in (-1.5, 3.0):
        readings = followed(lambda now, to=to: now if now < 2 else now + to)
        settled = readings[int(2.2 * 60) :]
        expected = np.arange(len(readings))[int(2.2 * 60) :] / 60 + to
        assert np.abs(settled - expected).max() < 0.02


def test_an_error_of_a_fifth_of_a_second_is_made_up_within_one_without_a_jump() -> None:
    """The other clock is 0.2 s further at once, as after a pause of a player: the pace doubles until it is made up."""
    readings = followed(lambda now: now if now < 2 else now + 0.2)
    ahead = readings - np.arange(len(readings)) / 60
    assert np.diff(readings).max() * 60 < 2.1
    assert 0.05 < ahead[126] < 0.15
    assert ahead[156] == pytest.approx(0.2, abs=0.02)


def test_rare_reports_are_followed_evenly() -> None:
    """A player that reports its place eleven times a second."""
    clock, readings = FollowingClock(), []
    for frame in range(240):
        if frame % 5 == 0:
            clock.tell(frame / 60 * RATE, frame / 60)
        readings.append(clock.read(frame / 60))
    speed = np.diff(np.array(readings, float)) / RATE * 60
    assert speed.min() > 0.9
    assert speed.max() < 1.1


def test_without_reports_the_clock_stops() -> None:
    clock = FollowingClock()
    clock.tell(0, 0.0)
    last = [clock.read(now) for now in np.arange(0, 3, 1 / 60)][-1]
    assert last is not None
    assert last <= 0.25 * RATE


def test_after_a_jump_it_takes_over_the_next_report() -> None:
    clock = FollowingClock()
    clock.tell(0, 0.0)
    clock.read(0.0)
    clock.tell(0.2 * RATE, 0.01)
    clock.jump()
    assert clock.read(0.01) == 0.2 * RATE
