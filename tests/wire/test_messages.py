"""Rules that every message follows."""

from typing import get_args

import pytest

from echoavatar.wire.messages import CLOSE_CODES, ClientMessage, ErrorCode, ServerMessage


@pytest.mark.parametrize("kind", get_args(ClientMessage) + get_args(ServerMessage))
def test_every_message_says_what_it_is_for(kind: type) -> None:
    assert kind.__doc__


def test_the_messages_are_those_of_the_protocol() -> None:
    tags = [{kind.__struct_config__.tag for kind in get_args(union)} for union in (ClientMessage, ServerMessage)]
    assert tags[0] == {"hello", "audio", "end", "interrupt", "action", "manner", "words", "music", "played", "ping"}
    assert tags[1] == {
        *("ready", "motion", "audio", "opus", "flush", "action_status", "state", "stats", "error", "pong")
    }


def test_every_error_code_has_a_close_code() -> None:
    assert set(CLOSE_CODES) == set(get_args(ErrorCode))
    assert all(code == 1009 or 1011 <= code <= 1013 or 4000 <= code < 5000 for code in CLOSE_CODES.values())
