import pytest
from tests.server.fakes import Body

from echoavatar.evaluation.sessions_bench import bench_neighbour, bench_sessions, summary


class Clockwork:
    """Every tick takes the same time, whatever the machine does."""

    def __init__(self, tick_s: float) -> None:
        self.now, self.tick_s = 0.0, tick_s

    def __call__(self) -> float:
        self.now += self.tick_s
        return self.now


def test_a_light_load_waits_for_its_own_tick_only() -> None:
    (load,) = bench_sessions(Body(), (1,), seconds=3, clock=Clockwork(0.03))  # type: ignore[arg-type]
    assert load.p50_ms == pytest.approx(30, abs=0.2)
    assert load.p99_ms == pytest.approx(30, abs=0.2)
    assert load.busy == pytest.approx(0.03 / 0.2667, rel=0.1)
    assert load.in_real_time


def test_ticks_longer_than_a_chunk_are_not_in_real_time() -> None:
    loads = bench_sessions(Body(), (1, 2, 3), seconds=3, clock=Clockwork(0.3))  # type: ignore[arg-type]
    assert not loads[0].in_real_time
    assert summary(loads)["sessions_in_real_time"] == 0


def test_neighbours_do_not_matter_more_than_a_tick() -> None:
    p99 = bench_neighbour(Body(), seconds=3, clock=Clockwork(0.01))  # type: ignore[arg-type]
    assert set(p99) == {"behaves", "floods", "stalls", "vanishes"}
    assert max(p99.values()) <= 20.5
