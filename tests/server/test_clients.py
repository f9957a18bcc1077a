"""Clients that send too much: they wait or are refused, nothing of theirs is lost, and others notice nothing."""

import dataclasses
import time

import pytest
from tests.server.fakes import FAST, serving

from echoavatar.server.clients import ClientLimits, ClientRates
from echoavatar.wire.messages import Action, ActionStatus, Hello, Motion, Ping, Played, Pong
from echoavatar.wire.rates import Rate

SLOW = Rate(5, 600)  # ten a second


def test_pings_beyond_the_rate_are_answered_later_and_none_is_lost() -> None:
    settings = dataclasses.replace(FAST, rates=ClientRates(reports=SLOW))
    with serving(settings=settings) as server, server.call(Hello(seed=1)) as other:
        with server.call(Hello(role="viewer", session=other.ready.session, want=())) as flooder:
            began = time.monotonic()
            for number in range(15):
                flooder.say(Ping(nonce=number))
            assert [flooder.until(Pong).nonce for _ in range(15)] == list(range(15))
            assert time.monotonic() - began > 0.9
        at = other.until(Motion).at
        assert other.until(Motion, lambda motion: motion.at > at).at == at + 6_400


def test_commands_beyond_the_rate_are_done_later_and_reports_have_a_bucket_of_their_own() -> None:
    settings = dataclasses.replace(FAST, rates=ClientRates(commands=SLOW))
    with serving(settings=settings) as server, server.call(Hello()) as caller:
        began = time.monotonic()
        for number in range(10):
            caller.say(Action(id=str(number), name="nothing of ours"))
        for number in range(10):
            assert caller.until(ActionStatus).id == str(number)
        assert time.monotonic() - began > 0.5
        began = time.monotonic()
        caller.say(Played(at=0))
        caller.say(Ping(nonce=1))
        caller.until(Pong)
        assert time.monotonic() - began < 0.4


def test_requests_beyond_the_rate_are_refused_with_the_time_to_wait() -> None:
    settings = dataclasses.replace(FAST, rates=ClientRates(requests=Rate(3, 1)))
    with serving(settings=settings) as server:
        assert [server.http("/health")[0] for _ in range(4)] == [200, 200, 200, 429]
        status, told = server.http("/v1/tools")
        assert status == 429
        assert "try again in" in told["error"]
        with pytest.raises(Exception, match="403"):
            server.call(Hello())


def test_calls_of_tools_beyond_the_rate_are_refused() -> None:
    settings = dataclasses.replace(FAST, rates=ClientRates(commands=Rate(2, 1)))
    with serving(settings=settings) as server, server.call(Hello()):
        wave = b'{"arguments": {"name": "wave"}}'
        assert [server.http("/v1/tools/send_action", wave)[0] for _ in range(3)] == [200, 200, 429]


def test_guesses_over_http_and_in_hellos_count_together_and_the_right_token_goes_on() -> None:
    settings = dataclasses.replace(FAST, token="right")
    with serving(settings=settings) as server, server.call(Hello(token="right")) as good:
        codes = [server.http("/v1/tools", authorization=f"Bearer {number}")[0] for number in range(12)]
        assert codes == [401] * 10 + [429] * 2
        with server.call() as caller:
            caller.say(Hello(token="wrong"))
            code, error = caller.closing()
        assert error is not None
        assert (code, error.code) == (4429, "overloaded")
        assert 0 < error.retry_after <= 10
        assert server.http("/v1/tools", authorization="Bearer right")[0] == 200
        at = good.until(Motion).at
        good.until(Motion, lambda motion: motion.at > at)


async def test_a_request_is_held_for_a_moment_before_it_is_refused() -> None:
    limits = ClientLimits(ClientRates(requests=Rate(1, 600)), "")
    began = time.monotonic()
    assert [await limits.hold("a") for _ in range(3)] == [0, 0, 0]
    assert time.monotonic() - began > 0.18
