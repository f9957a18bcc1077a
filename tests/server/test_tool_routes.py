"""Tools over HTTP: who may, and what is refused."""

import asyncio
import json
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import soundfile
from starlette.requests import Request
from starlette.types import Message
from tests.engine.fakes import engine
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar.engine import SessionCore
from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.engine.tools import Toolbox
from echoavatar.errors import EchoAvatarError
from echoavatar.server.tool_routes import call_tool, read_body
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


LIBRARY = ActionLibrary({name: Action(name, (1, 2, 3, 4), (0, 1), f"to {name}") for name in ("wave", "bow", "listen")})


@pytest.fixture
def session() -> SessionCore:
    machine = engine()
    machine.actions = LIBRARY
    return machine.open_core()


@pytest.fixture
def call(tmp_path: Path, session: SessionCore) -> Callable[..., dict[str, Any]]:
    soundfile.write(tmp_path / "My_Tune.wav", np.tile(np.float32([0.1, -0.1]), 12_000), 24_000)
    tracks = Tracks(tmp_path)

    async def load(title: str) -> np.ndarray:
        return tracks.load(title)

    manager = SimpleNamespace(toolbox=Toolbox(LIBRARY, tracks, has_manner=True), tracks=tracks, load_track=load)
    return lambda name, arguments, on=session: asyncio.run(call_tool(manager, on, name, arguments))


def test_a_model_waves_and_hears_what_became_of_it(call: Callable[..., dict[str, Any]], session: SessionCore) -> None:
    answer = call("send_action", {"action": "wave", "intensity": 1.5, "hold": None})
    assert answer["status"] == "accepted"
    assert [status.name for status in session.take_statuses()] == ["wave"]
    assert call("list_actions", {}) == {"actions": {"wave": "to wave", "bow": "to bow"}}


def test_a_call_sets_the_manner(call: Callable[..., dict[str, Any]]) -> None:
    told = Mock()
    assert call("set_manner", {"liveliness": 0.2}, told) == {"status": "done"}
    told.set_manner.assert_called_once_with(liveliness=0.2)
    assert "from 0 to 1" in call("set_manner", {"liveliness": 2}, told)["reason"]


@pytest.mark.parametrize(
    ("name", "arguments", "reason"),
    [
        ("send_action", {"action": "moonwalk"}, "there are: wave, bow"),
        ("send_action", {}, "needs 'action'"),
        ("send_action", {"action": "wave", "intensity": "much"}, "must be a number from 0 to 2"),
        ("send_action", {"action": "wave", "speed": 2}, "knows no 'speed'"),
        ("send_action", {"action": "wave", "intensity": 5}, "a number from 0 to 2"),
        ("send_action", {"action": "wave", "intensity": 10**400}, "must be a number"),
        ("send_action", {"action": "wave", "hold": float("nan")}, "must be a number"),
        ("play_music", {"title": "Silence"}, "My Tune"),
        ("fly", {}, "there are: send_action"),
    ],
)
def test_what_cannot_be_is_rejected_with_the_reason(
    call: Callable[..., dict[str, Any]], name: str, arguments: dict[str, Any], reason: str
) -> None:
    answer = call(name, arguments)
    assert answer["status"] == "rejected"
    assert reason in answer["reason"]


def test_music_is_heard_by_the_session_and_stops(call: Callable[..., dict[str, Any]], session: SessionCore) -> None:
    assert call("play_music", {"title": "my_tune"}) == {"status": "accepted", "title": "My Tune"}
    session._host.tick()
    delivery = session.take()
    assert delivery is not None
    assert delivery.source == "music"
    np.testing.assert_allclose(np.abs(delivery.audio), 0.1, atol=1e-3)
    assert call("stop_music", {}) == {"status": "done"}
    for _ in range(3):
        session._host.tick()
    assert not session.is_ready


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
