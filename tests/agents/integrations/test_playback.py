"""Playback estimates with times given by hand; a second is 24,000 samples."""

import pytest

from echoavatar.agents.integrations.playback import Playback


def test_without_reports_the_wall_clock_counts_up_to_the_end_of_the_sound() -> None:
    playback = Playback(0, 10.0)
    playback.pushed(0, 24_000, audible=True)
    assert playback.position(10.5) == 12_000
    assert playback.is_sounding
    assert playback.position(12.0) == 24_000
    assert not playback.is_sounding
    playback.pushed(24_000, 24_000, audible=False)
    assert playback.position(12.5) == 36_000


def test_reports_are_believed_and_the_clock_runs_on_between_them() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(0.04, 0.3)  # playback began late
    assert playback.position(0.3) == 960
    assert playback.position(0.34) == pytest.approx(1_920, abs=1)


def test_a_transport_that_is_stuck_stops_the_clock() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(0.5, 0.5)
    assert playback.position(9.0) == 12_000 + 2_400  # a tenth of a second on


def test_a_sentence_whose_end_is_stuck_stops_the_clock_in_the_silence_after_it() -> None:
    """A tenth of a second is missing, which is more than a block."""
    playback = Playback(0, 0.0)
    playback.pushed(0, 24_000, audible=True)
    playback.pushed(24_000, 24_000, audible=False)
    playback.wrote(0.9, 1.0)
    assert playback.position(9.0) == 24_000


def test_silence_between_sounds_takes_time_without_reports() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 24_000, audible=True)
    playback.pushed(24_000, 24_000, audible=False)
    playback.pushed(48_000, 24_000, audible=True)
    playback.wrote(0.98, 1.0)  # the last block is kept back until more sound comes
    assert playback.position(1.5) == pytest.approx(0.98 * 24_000 + 12_000, abs=1)
    assert playback.position(9.0) == 48_000 + 2_400
    playback.wrote(0.02 + 0.1, 9.0)
    assert playback.position(9.0) == pytest.approx(48_000 + 2_400, abs=1)


def test_an_exact_report_overrides_the_estimate() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 24_000, audible=True)
    playback.plays(6_000, 1.0)
    assert playback.position(1.0) == 6_000
    playback.plays(99_000, 1.0)
    assert playback.position(1.0) == 24_000


def test_after_a_cut_it_stands_there() -> None:
    playback = Playback(0, 0.0)
    playback.pushed(0, 48_000, audible=True)
    playback.wrote(1.0, 1.0)
    playback.jump(24_000, 1.0)
    playback.wrote(0.04, 1.1)  # a block that was being written during the jump
    assert playback.position(5.0) == 24_000
    assert not playback.is_sounding
