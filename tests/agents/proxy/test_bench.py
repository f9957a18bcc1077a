"""The benchmark sends the same events over all routes, with an avatar that moves."""

import pytest
from tests.agents.proxy.places import avatar_server

from echoavatar.agents.proxy import bench
from echoavatar.agents.proxy.bench import ROUTES, bench_proxy


def test_all_routes_carry_the_same_and_the_avatar_moves_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "WARM_UP_S", 1.0)
    with avatar_server() as server:
        report = bench_proxy(server.address, seconds=3.0)
    assert set(report.routes) == set(ROUTES)
    assert {route.events for route in report.routes.values()} == {75}
    assert all(0 < route.p50 <= route.p95 <= route.p99 <= route.most for route in report.routes.values())
    assert report.frames >= 60
    assert {"added_p99_ms", "proxy_p99_ms", "relay_p99_ms"} <= report.summary.keys()
