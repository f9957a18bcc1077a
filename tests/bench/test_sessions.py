import pytest
from tests.server.fakes import Body

from echoavatar.bench import sessions as sessions_bench
from echoavatar.bench.sessions import Load, bench_neighbour, bench_sessions, summary


@pytest.fixture(autouse=True)
def _no_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions_bench, "WARM_UP_CHUNKS", 1)


def test_a_chunk_waits_for_its_own_step_at_least() -> None:
    (load,) = bench_sessions(Body(0.05), (1,), seconds=1)  # type: ignore[arg-type]
    assert 50 <= load.p50_ms <= load.p99_ms
    assert 0 < load.busy <= 1
    if load.in_real_time:  # the machine may be busy
        assert load.p99_ms <= 266.7


def test_steps_longer_than_a_chunk_are_not_in_real_time() -> None:
    loads = bench_sessions(Body(0.3), (1,), seconds=1)  # type: ignore[arg-type]
    assert not loads[0].in_real_time
    assert loads[0].admitted == 1
    assert summary(loads)["sessions_in_real_time"] == 0


def test_every_manner_of_neighbour_is_tried() -> None:
    p99 = bench_neighbour(Body(0.01), seconds=1)  # type: ignore[arg-type]
    assert set(p99) == {"behaves", "floods", "stalls", "vanishes"}
    assert min(p99.values()) >= 10


def test_the_summary_names_the_largest_load_in_real_time() -> None:
    loads = [Load(1, 1, 9, 9, 0, 0.1, 1, True), Load(4, 2, 9, 9, 0, 0.2, 1, True), Load(3, 3, 9, 900, 7, 0.9, 1, False)]
    assert summary(loads)["sessions_in_real_time"] == 2


def test_who_finds_no_room_is_not_served() -> None:
    (load,) = bench_sessions(Body(0.2), (3,), seconds=1)  # type: ignore[arg-type]
    assert load.admitted == 1
    assert load.late > 0
