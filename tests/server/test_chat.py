"""The chat box's other end: what is said is answered, and done in the client's own session."""

import json
from collections.abc import Iterator

import pytest
from tests.server.fakes import RunningServer, serving

from echoavatar.wire.messages import ActionStatus, Hello


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("ECHOAVATAR_CHAT_URL", raising=False)
        with serving() as server:
            yield server


def test_the_companion_is_named(server: RunningServer) -> None:
    assert server.http("/v1/chat") == (200, {"name": "script", "hears": False})


def test_what_is_asked_for_happens_in_the_session_that_asks(server: RunningServer) -> None:
    with server.call(Hello()) as first, server.call(Hello()):
        body = {"session": first.ready.session, "text": "hello", "history": [{"role": "user", "text": 3}, 7]}
        status, answer = server.http("/v1/chat", json.dumps(body).encode())
        assert (status, answer["did"]) == (
            200,
            [{"name": "send_action", "arguments": {"action": "wave"}, "status": "accepted"}],
        )
        assert "Producer" in answer["say"]
        assert first.until(ActionStatus).name == "wave"
        body["text"] = "music!"
        assert server.http("/v1/chat", json.dumps(body).encode())[1]["did"][0]["status"] == "accepted"
        assert first.until(ActionStatus, lambda told: told.name in first.ready.tracks).status == "accepted"


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b'{"text": "hi"}', {}, 404),  # nobody is there
        (b'{"text": "  "}', {}, 400),
        (b'{"text": ' + b'"x"' * 1_000 + b"}", {}, 400),
        (json.dumps({"text": "x" * 3_000}).encode(), {}, 400),
        (b'{"text": "hi"}', {"content_type": "text/plain"}, 400),
        (b'{"text": "hi"}', {"origin": "https://evil.example"}, 403),
    ],
)
def test_invalid_requests_are_refused(server: RunningServer, body: bytes, headers: dict[str, str], status: int) -> None:
    assert server.empties()
    assert server.http("/v1/chat", body, **headers)[0] == status


def test_the_script_cannot_transcribe(server: RunningServer) -> None:
    status, answer = server.http("/v1/chat/ears", b"RIFF", content_type="audio/wav")
    assert (status, "ECHOAVATAR_CHAT_EARS" in answer["error"]) == (400, True)
    assert server.http("/v1/chat/ears", b"RIFF", content_type="text/plain")[0] == 400
    assert server.http("/v1/chat/ears", b"RIFF", content_type="audio/wav", origin="https://evil.example")[0] == 403
