"""The clock by which lateness is judged."""

from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.bench.neighbours import Arrivals, bench_neighbours

CHUNK, CHUNK_S = 6_400, 6_400 / 24_000


def arrivals(late: dict[int, float], count: int = 60) -> Arrivals:
    """Chunks on a clock that began at 100 s, each so much too late."""
    return Arrivals({n * CHUNK: 100 + n * CHUNK_S + late.get(n, 0.0) for n in range(count)})


def test_a_chunk_is_due_when_those_before_it_were_played() -> None:
    late, got = arrivals({30: 0.5, 31: 0.2}).lateness(104.0, 112.0, CHUNK)
    assert (len(late), got) == (30, 30)
    assert sorted(late)[-3:] == pytest.approx([0.0, 0.2, 0.5], abs=1e-6)


def test_a_jitter_of_the_quiet_start_moves_no_clock() -> None:
    late, _ = arrivals({2: 0.3, 5: 0.4}).lateness(104.0, 112.0, CHUNK)
    assert max(late) == pytest.approx(0.0, abs=1e-6)


def test_what_did_not_come_is_late_until_the_end() -> None:
    late, got = arrivals({}, count=20).lateness(104.0, 112.0, CHUNK)
    assert (len(late), got) == (30, 5)
    assert max(late) == pytest.approx(112.0 - (100 + 20 * CHUNK_S))


def test_a_server_that_sends_nothing_in_the_quiet_start_is_not_judged() -> None:
    with pytest.raises(EchoAvatarError, match="too slow"):
        Arrivals().lateness(104.0, 112.0, CHUNK)


def measure(model: str, only: str) -> list[dict[str, object]]:
    return bench_neighbours(model, servers=(), token="", certificate="", only=(only,), seconds=3.0, tell=lambda _: None)


def test_an_unknown_neighbour_is_said() -> None:
    with pytest.raises(EchoAvatarError, match="choose from nobody, offers"):
        measure("default", "the dog")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["played at 0", "stalled TLS handshakes"])
def test_a_tiny_bundle_beside_a_neighbour(tiny_bundle: Path, name: str) -> None:
    (row,) = measure(str(tiny_bundle), name)
    assert row["neighbour"] == name
    assert int(str(row["got"])) >= 9
