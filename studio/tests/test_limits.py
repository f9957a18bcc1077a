"""Token buckets on a clock of our own."""

import pytest

from echoavatar_studio.limits import Limiter, Rate


def test_a_burst_passes_then_one_at_a_time():
    now = [0.0]
    limiter, rate = Limiter(lambda: now[0]), Rate(3, 60)
    assert [limiter.wait("a", rate) for _ in range(3)] == [0, 0, 0]
    assert limiter.wait("a", rate) == pytest.approx(1.0)
    assert limiter.wait("b", rate) == 0  # somebody else
    now[0] = 0.5
    assert limiter.wait("a", rate) == pytest.approx(0.5)
    now[0] = 1.0
    assert limiter.wait("a", rate) == 0


def test_old_keys_are_forgotten():
    limiter = Limiter(lambda: 0.0)
    for number in range(25_000):
        limiter.wait(str(number), Rate(1, 1))
    assert len(limiter._levels) == 20_000
