"""Token buckets on a clock of our own."""

import pytest

from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.rates import Limiter, Rate, TokenGate


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


def test_what_waits_is_counted_and_what_is_refused_or_only_asked_is_not():
    limiter, rate = Limiter(lambda: 0.0), Rate(1, 60)
    assert [limiter.wait("a", rate, patience=2.0) for _ in range(3)] == [0, 1, 2]
    assert [limiter.wait("a", rate, patience=2.0) for _ in range(3)] == [3, 3, 3]
    assert [limiter.wait("b", rate, patience=-1) for _ in range(3)] == [0, 0, 0]


class Door:
    """A gate on a clock of our own."""

    def __init__(self) -> None:
        self.now = 0.0
        self.gate = TokenGate("right", lambda: self.now)

    def try_token(self, token: str, address: str) -> tuple[str, float]:
        """The error of an attempt, and when to try again."""
        try:
            self.gate.check(token, {}, address)
        except ProtocolError as error:
            return error.code, error.retry_after
        return "", 0.0


def test_after_some_wrong_tokens_an_address_waits_even_with_the_right_one():
    door = Door()
    assert {door.try_token(f"wrong{number}", "10.0.0.1")[0] for number in range(10)} == {"unauthorized"}
    assert door.try_token("wrong", "10.0.0.1") == ("overloaded", pytest.approx(10.0))
    assert door.try_token("right", "10.0.0.1") == ("overloaded", pytest.approx(10.0))
    assert door.try_token("right", "10.0.0.2") == ("", 0.0)
    door.now = 10.0
    assert door.try_token("right", "10.0.0.1") == ("", 0.0)


def test_guesses_behind_the_router_of_an_office_lock_out_nobody_who_was_let_in():
    door = Door()
    assert door.try_token("right", "10.0.0.1") == ("", 0.0)
    codes = [door.try_token(f"wrong{number}", "10.0.0.1")[0] for number in range(2_000)]
    assert codes.count("unauthorized") == 10
    assert door.try_token("right", "10.0.0.1") == ("", 0.0)


def test_guesses_from_many_addresses_of_one_network_count_together():
    door = Door()
    codes = [door.try_token("wrong", f"2001:db8::{number:x}")[0] for number in range(40)]
    assert codes.count("unauthorized") == 10


def test_wrong_tokens_leave_one_line_a_minute_without_the_token(caplog: pytest.LogCaptureFixture):
    door = Door()
    for number in range(1_800):
        door.now = number / 20
        door.try_token(f"guess{number}", "10.0.0.1")
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 2
    assert lines[0] == "wrong tokens: 1 since the last such line, the newest from 10.0.0.1"
    assert "guess" not in lines[1]
