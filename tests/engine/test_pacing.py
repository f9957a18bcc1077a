from echoavatar.engine.pacing import Playhead


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
