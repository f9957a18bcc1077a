"""Refusals become problems with a status of their own."""

from typing import get_args

from echoavatar_studio.errors import StudioError, not_found
from echoavatar_studio.wire import STATUS, ErrorCode


def test_a_refusal_is_a_problem():
    refusal = StudioError("too_many_requests", "wait", retry_after=2.5)
    assert refusal.status == 429
    assert (refusal.problem.code, refusal.problem.message, refusal.problem.retry_after) == (
        "too_many_requests",
        "wait",
        2.5,
    )
    assert not_found().status == 404


def test_every_code_has_a_status():
    assert set(STATUS) == set(get_args(ErrorCode))
