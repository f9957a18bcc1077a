"""The benchmark sends the same events all ways, with an avatar that moves."""

from tests.agents.proxy.places import avatar_server

from echoavatar.agents.proxy.bench import WAYS, bench_proxy


def test_all_ways_carry_the_same_and_the_avatar_moves_to_it() -> None:
    with avatar_server() as server:
        report = bench_proxy(server.address, seconds=6.0)
    assert set(report.ways) == set(WAYS)
    assert {way.events for way in report.ways.values()} == {150}
    assert all(0 < way.p50 <= way.p95 <= way.p99 <= way.most for way in report.ways.values())
    assert report.frames >= 120
    assert {"added_p99_ms", "proxy_p99_ms", "relay_p99_ms"} <= report.summary.keys()
