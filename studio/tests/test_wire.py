"""What all messages share."""

import msgspec
import pytest

from echoavatar_studio.wire import Problem, Request


class Ask(Request):
    number: int


def test_requests_refuse_what_they_do_not_know():
    assert msgspec.json.decode(b'{"number": 1}', type=Ask).number == 1
    for wrong in (b'{"number": 1, "more": 2}', b'{"number": "1"}', b"{}"):
        with pytest.raises(msgspec.ValidationError):
            msgspec.json.decode(wrong, type=Ask)


def test_problems_are_read_back():
    problem = Problem(code="busy", message="wait")
    assert msgspec.json.decode(msgspec.json.encode(problem), type=Problem) == problem
