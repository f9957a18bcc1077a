"""Tools over HTTP: who may, and what is refused."""

import asyncio
import json
import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from starlette.requests import Request
from starlette.types import Message
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar.errors import EchoAvatarError
from echoavatar.server.tool_routes import read_body
from echoavatar.wire.messages import Hello


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving() as server:
        yield server


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"{}", {}, 200),
        (b"{}", {"content_type": "text/plain"}, 400),  # what a form of another page can send
        (b"{}", {"origin": "https://evil.example"}, 403),
        (b"[]", {}, 400),
        (b"{", {}, 400),
        (b'{"arguments": []}', {}, 200),
        (b'{"arguments": [1]}', {}, 400),
        (b'{"session": "nobody"}', {}, 404),
        (b'"' + b"x" * 20_000 + b'"', {}, 400),
        (b"[" * 9_000, {}, 400),
        (b'{"arguments": {"title": "\\ud800"}}', {}, 400),
        (b'{"session": "\xed\xa0\x80"}', {}, 400),
        (b"{}", {"content_type": "text/plain; x=application/json"}, 400),
    ],
)
def test_invalid_requests_are_refused(server: RunningServer, body: bytes, headers: dict[str, str], status: int) -> None:
    with server.call(Hello()):
        assert server.http("/v1/tools/stop_music", body, **headers)[0] == status


def test_a_server_of_many_does_not_say_who_is_there(server: RunningServer) -> None:
    with server.call(Hello()) as caller:
        assert server.http("/v1/tools/stop_music", b"{}", x_forwarded_for="1.2.3.4")[0] == 404
        named = json.dumps({"session": caller.ready.session}).encode()
        assert server.http("/v1/tools/stop_music", named, x_forwarded_for="1.2.3.4")[0] == 200
    with serving(settings=replace(FAST, lists_sessions=False)) as shared, shared.call(Hello()) as caller:
        assert shared.http("/v1/tools/stop_music", b"{}")[0] == 404
        assert shared.http("/v1/chat", b'{"text": "hi"}')[0] == 404
        named = json.dumps({"session": caller.ready.session}).encode()
        assert shared.http("/v1/tools/stop_music", named)[0] == 200
        assert shared.http("/v1/sessions")[0] == 403


def test_without_a_session_there_is_nothing_to_do(server: RunningServer) -> None:
    assert server.empties()
    assert server.http("/v1/tools/stop_music", b"{}")[0] == 404


@pytest.mark.parametrize("arguments", [{"title": "No such tune"}, {"title": 3}])
def test_music_that_is_not_there_is_rejected(server: RunningServer, arguments: dict[str, object]) -> None:
    with server.call(Hello()):
        body = json.dumps({"arguments": arguments}).encode()
        status, answer = server.http("/v1/tools/play_music", body)
        assert (status, answer["status"]) == (200, "rejected")


def test_a_track_is_decoded_away_from_the_event_loop(server: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Decoding takes seconds when the cache does not hold the track; neighbours must not wait for it."""
    load, threads = server.manager.tracks.load, []

    def noted(title: str) -> np.ndarray:
        threads.append(threading.get_ident())
        return load(title)

    monkeypatch.setattr(server.manager.tracks, "load", noted)
    with server.call(Hello()):
        answer = server.http("/v1/tools/play_music", b"{}")[1]
    assert answer["status"] == "accepted"
    assert len(threads) == 1
    assert server.thread.ident not in threads


def test_a_number_that_no_float_holds_is_rejected_in_words(server: RunningServer) -> None:
    body = b'{"arguments": {"action": "wave", "intensity": 1' + b"0" * 400 + b"}}"
    with server.call(Hello()):
        status, answer = server.http("/v1/tools/send_action", body)
    assert status == 400
    assert "no float holds" in answer["error"]


def request(parts: Iterable[bytes], pause: float = 0.0) -> Request:
    left = list(parts)

    async def receive() -> Message:
        await asyncio.sleep(pause)
        part = left.pop(0)
        return {"type": "http.request", "body": part, "more_body": bool(left)}

    return Request({"type": "http", "method": "POST", "headers": []}, receive)


def test_a_body_is_read_whole() -> None:
    assert asyncio.run(read_body(request([b"one ", b"two"]), 7)) == b"one two"


def test_a_body_is_bounded_in_size_and_time() -> None:
    with pytest.raises(EchoAvatarError, match="more than 6 bytes"):
        asyncio.run(read_body(request([b"one ", b"two"]), 6))
    with pytest.raises(EchoAvatarError, match="did not come within 0.05 s"):
        asyncio.run(read_body(request([b"x"] * 100, pause=0.02), 1_000, seconds=0.05))
