import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.engine.fakes import engine

from echoavatar.engine.pacing import Pacer, Playhead


def test_it_runs_by_the_wall_clock_and_waits_for_motion() -> None:
    head = Playhead()
    head.advance(10.0, 0)
    head.advance(11.0, 0)
    assert head.sample == 0
    head.advance(11.5, 6_400)
    assert head.sample == 6_400
    head.advance(11.6, 64_000)
    assert head.sample == 6_400 + 2_400


def test_reports_win_and_a_silent_player_stops_the_clock() -> None:
    head = Playhead()
    head.advance(0.0, 480_000)
    head.report(48_000, 0.0, 480_000)
    head.advance(0.5, 480_000)
    assert head.sample == 60_000
    head.advance(9.0, 480_000)
    assert head.sample == 72_000  # one second of patience


def test_a_report_beyond_what_was_sent_is_cut() -> None:
    head = Playhead()
    head.report(10**12, 0.0, 6_400)
    assert head.sample == 6_400


def test_a_pause_does_not_count() -> None:
    head = Playhead()
    head.advance(0.0, 64_000)
    head.advance(1.0, 64_000)
    head.pause()
    head.advance(100.0, 64_000)
    assert head.sample == 24_000
    head.jump(12_000)
    assert head.sample == 12_000


def test_it_says_when_it_will_be_at_a_sample_or_that_it_waits_before() -> None:
    head = Playhead()
    head.advance(10.0, 24_000)
    assert head.reaches(12_000, 10.0, 24_000) == 10.5
    assert head.reaches(30_000, 10.0, 24_000) is None  # there is no motion yet
    head.report(0, 10.0, 96_000)
    assert head.reaches(24_000, 10.0, 96_000) == 11.0
    assert head.reaches(36_000, 10.0, 96_000) is None  # nobody says that the player goes on
    assert head.waits_at(96_000) == 24_000
    assert head.waits_at(6_400) == 6_400


@given(
    beats=st.lists(st.floats(0.01, 0.4), min_size=5, max_size=40),
    speech=st.lists(st.integers(0, 40_000), min_size=5, max_size=5),
)
@settings(max_examples=30, deadline=None)
def test_a_call_before_the_deadline_schedules_nothing_and_one_at_it_does(beats: list[float], speech: list[int]) -> None:
    """So the owner need not ask in between, unless something happens."""
    machine = engine()
    core = machine.open_core(is_paced=True)
    pacer, now, end = Pacer(core, ahead_seconds=2.0), 100.0, 0

    def make() -> int:
        while machine.tick():
            pass
        made = end
        while (delivery := core.take()) is not None:
            made = delivery.start + len(delivery.audio)
        return made

    for number, beat in enumerate(beats):
        if number < len(speech) and speech[number]:
            core.push(np.zeros(speech[number], np.float32))
        pacer.advance(now, end)
        pacer.schedule(now)
        end = make()
        deadline = pacer.deadline(now, end)
        assert deadline is not None  # all motion is there, so only time is missing
        early = min(now + beat, deadline - 1e-3)
        if early > now:
            pacer.advance(early, end)
            assert pacer.schedule(early) == []
            now = early
        now = max(now, deadline) + 1e-4
        pacer.advance(now, end)
        assert pacer.schedule(now)
        end = make()
