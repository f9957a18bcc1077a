"""Owners' messages keep their limits."""

import msgspec
import pytest

from echoavatar_studio.wire_owner import ChangeState, Invite, Login, NewStudy


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (Login, b'{"name":"","password":"x"}'),
        (Login, b'{"name":"a","password":"' + b"x" * 300 + b'"}'),
        (NewStudy, b'{"settings":"' + b"x" * 20_001 + b'"}'),
        (ChangeState, b'{"state":"failed"}'),
        (Invite, b'{"count":501}'),
        (Invite, b'{"is_open":1}'),
    ],
)
def test_what_is_out_of_range_is_refused(kind, text):
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(text, type=kind)


def test_an_invitation_is_personal_unless_said():
    assert msgspec.json.decode(b"{}", type=Invite) == Invite(count=1, is_open=False, label="")
