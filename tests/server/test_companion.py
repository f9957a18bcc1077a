"""The script, a language model whose endpoint is a small HTTP server, and the routes of the chat box."""

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.http_server import Handler, HttpServer, running
from tests.server.fakes import RunningServer, serving

from echoavatar.errors import EchoAvatarError
from echoavatar.server import companion
from echoavatar.server.companion import MOST_SOUND, PERSONA, ChatModel, Companion, from_environment
from echoavatar.server.ears import Ears
from echoavatar.server.script import ChatTurn, Scripted, ToolAccess, choices
from echoavatar.wire.messages import ActionStatus, Hello

Answer = Callable[[str, Any], tuple[int, Any]]
URL = "http://127.0.0.1:9/v1"


def _tool(name: str, argument: str, **schema: object) -> dict[str, object]:
    return {"function": {"name": name, "parameters": {"properties": {argument: schema}}}}


def test_choices_are_the_values_that_a_tool_declares() -> None:
    tools = [_tool("play_music", "title", enum=["Waltz"]), _tool("send_action", "action")]
    assert choices(tools, "play_music", "title") == ["Waltz"]
    assert choices(tools, "send_action", "action") == []
    assert choices(tools, "stop_music", "title") == []


@pytest.mark.parametrize("companion", [Scripted(), ChatModel("http://127.0.0.1:9/v1", model="m")])
def test_both_kinds_are_companions(companion: Companion) -> None:
    assert companion.name
    assert not companion.hears


@contextmanager
def endpoint(answer: Answer) -> Iterator[tuple[str, list[tuple[str, dict[str, str], Any]]]]:
    got: list[tuple[str, dict[str, str], Any]] = []

    def act(handler: Handler) -> None:
        is_json = handler.given["content-type"] == "application/json"
        content = json.loads(handler.body) if is_json else handler.body
        got.append((handler.path, handler.given, content))
        handler.answer(*answer(handler.path, content))

    with running(HttpServer(act)) as server:
        yield f"{server.url}/v1", got


def message(content: str | None, *calls: tuple[str, str]) -> dict[str, Any]:
    tools = [
        {"id": f"c{k}", "type": "function", "function": {"name": name, "arguments": arguments}}
        for k, (name, arguments) in enumerate(calls)
    ]
    return {"choices": [{"message": {"role": "assistant", "content": content, "tool_calls": tools}}]}


def talk(model: ChatModel, *history: ChatTurn) -> tuple[str, list[tuple[str, dict[str, Any]]]]:
    did: list[tuple[str, dict[str, Any]]] = []

    async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        did.append((name, arguments))
        return {"status": "accepted"}

    tools = [{"type": "function", "function": {"name": "send_action"}}]
    return asyncio.run(model.reply("hi", history, ToolAccess(tools, do))), did


def test_it_speaks_acts_and_remembers() -> None:
    said = message(" Watch this! ", ("send_action", '{"action": "wave"}'))
    with endpoint(lambda path, content: (200, said)) as (url, got):
        model = ChatModel(url, model="m", key="sk-1", persona="You are a lamp.")
        assert talk(model, ChatTurn("user", "a"), ChatTurn("assistant", "b")) == (
            "Watch this!",
            [("send_action", {"action": "wave"})],
        )
    [(path, headers, content)] = got
    assert path == "/v1/chat/completions"
    assert headers["authorization"] == "Bearer sk-1"
    assert [(m["role"], m["content"]) for m in content["messages"]] == [
        ("system", "You are a lamp."),
        ("user", "a"),
        ("assistant", "b"),
        ("user", "hi"),
    ]
    assert content["tools"][0]["function"]["name"] == "send_action"


def test_after_calls_alone_it_is_asked_for_words_and_not_for_ever() -> None:
    calls_alone = message(None, ("send_action", "no json"))
    with endpoint(lambda path, content: (200, calls_alone)) as (url, got):
        assert talk(ChatModel(url, model="m")) == ("", [])
    assert len(got) == 4
    assert got[1][2]["messages"][-1]["role"] == "tool"
    assert "rejected" in got[1][2]["messages"][-1]["content"]
    assert "tools" not in got[-1][2]


def test_a_model_that_calls_with_text_that_is_no_text_is_told_so() -> None:
    wrong = [("send_action", arguments) for arguments in ('{"action": "wave\\ud83d"}', "[" * 4500, '{"action": 1e999}')]
    with endpoint(lambda path, content: (200, message(None, *wrong))) as (url, got):
        assert talk(ChatModel(url, model="m")) == ("", [])
    assert all("not JSON" in told["content"] for told in got[1][2]["messages"][-3:])


@pytest.mark.parametrize(
    ("status", "told", "words"),
    [
        (200, {"choices": [{"message": "words"}]}, "form of Chat Completions"),
        (200, {"choices": [{"message": {"tool_calls": ["wave"]}}]}, "form of Chat Completions"),
        (200, {"choices": [{"message": {"tool_calls": [{"function": "wave"}]}}]}, "form of Chat Completions"),
        (401, {"error": "key sk-1"}, "HTTP 401"),
        (200, {"choices": []}, "form of Chat Completions"),
        (200, [1], "a JSON object"),
        (200, b"<html>", "no model answers"),
    ],
)
def test_errors_do_not_contain_the_key(status: int, told: Any, words: str) -> None:
    with endpoint(lambda path, content: (status, told)) as (url, _):
        with pytest.raises(EchoAvatarError, match=words) as caught:
            talk(ChatModel(url, model="m", key="sk-1"))
        assert "sk-1" not in str(caught.value)
    with pytest.raises(EchoAvatarError, match="ECHOAVATAR_CHAT_URL"):
        talk(ChatModel("http://127.0.0.1:9/v1", model="m"))


def test_spoken_words_are_transcribed() -> None:
    with endpoint(lambda path, content: (200, {"text": " hello "})) as (url, got):
        model = ChatModel(url, model="m", transcriber="whisper-1")
        assert asyncio.run(model.transcribe(b"RIFF....")) == "hello"
    path, headers, content = got[0]
    assert path == "/v1/audio/transcriptions"
    assert headers["content-type"].startswith("multipart/form-data; boundary=")
    assert b"whisper-1" in content
    assert b"RIFF...." in content
    with pytest.raises(EchoAvatarError, match="ECHOAVATAR_CHAT_EARS"):
        asyncio.run(ChatModel("http://x", model="m").transcribe(b""))


def test_the_default_persona_is_short_and_names_only_tools_that_exist() -> None:
    assert len(PERSONA) < 1_200
    assert {"send_action", "play_music", "stop_music"} <= set(PERSONA.replace(",", " ").split())
    assert PERSONA.isascii()


@pytest.fixture
def nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without a model server."""
    monkeypatch.setattr(companion, "LOCAL_SERVERS", {})


@pytest.mark.usefixtures("nobody")
def test_nothing_configured_is_the_script() -> None:
    assert isinstance(from_environment({}), Scripted)


def listing(*models: str) -> Any:
    return lambda path, _: (200, {"data": [{"id": model} for model in models]})


@contextmanager
def local(monkeypatch: pytest.MonkeyPatch, **answers: Answer) -> Iterator[None]:
    """Model servers on this machine; GET has no content."""
    with ExitStack() as stack:
        ports = {}
        for name, answer in answers.items():
            server = stack.enter_context(
                running(HttpServer(lambda handler, answer=answer: handler.answer(*answer(handler.path, None))))
            )
            ports[name] = int(server.url.rpartition(":")[2])
        monkeypatch.setattr(companion, "LOCAL_SERVERS", {"Closed": 9, **ports})
        yield


def test_a_model_server_of_this_machine_is_found_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    both = listing("nomic-embed-text", "qwen3:8b", "gemma3")
    with local(monkeypatch, web=lambda path, _: (404, b"<html>"), odd=lambda path, _: (200, [1]), ollama=both):
        model = from_environment({"ECHOAVATAR_CHAT_KEY": "sk-1"})
        assert isinstance(model, ChatModel)
        assert (model.name, model.where, model._key) == ("qwen3:8b", "ollama", "")
        assert from_environment({"ECHOAVATAR_CHAT_MODEL": "gemma3"}).name == "gemma3"
        assert isinstance(from_environment({"ECHOAVATAR_CHAT_URL": "script"}), Scripted)
        given = from_environment({"ECHOAVATAR_CHAT_URL": URL, "ECHOAVATAR_CHAT_MODEL": "m"})
        assert (given.name, given.where) == ("m", "127.0.0.1")


def test_a_server_that_has_no_model_that_talks_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with local(monkeypatch, ollama=listing("nomic-embed-text", "whisper-tiny"), empty=listing()):
        assert isinstance(from_environment({}), Scripted)


def test_a_model_without_tools_talks_at_least() -> None:
    def refuse(path: str, content: Any) -> tuple[int, Any]:
        return (400, {"error": "m does not support tools"}) if "tools" in content else (200, message("Hello."))

    with endpoint(refuse) as (url, got):
        model = ChatModel(url, model="m")
        assert [talk(model)[0], talk(model)[0]] == ["Hello.", "Hello."]
    assert ["tools" in content for _, _, content in got] == [True, False, False]


def test_an_endpoint_is_a_model_with_the_persona_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "me.txt").write_text("You are a lamp.")
    given = {
        "ECHOAVATAR_CHAT_URL": URL,
        "ECHOAVATAR_CHAT_MODEL": "m",
        "ECHOAVATAR_CHAT_EARS": "whisper",
        "ECHOAVATAR_PERSONA": str(tmp_path / "me.txt"),
    }
    model = from_environment(given)
    assert isinstance(model, ChatModel)
    assert (model.name, model.hears, model._persona) == ("m", "whisper", "You are a lamp.")


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        ({"ECHOAVATAR_CHAT_URL": URL}, "ECHOAVATAR_CHAT_MODEL"),
        ({"ECHOAVATAR_CHAT_URL": "file:///etc", "ECHOAVATAR_CHAT_MODEL": "m"}, "not an address"),
        (
            {"ECHOAVATAR_CHAT_URL": URL, "ECHOAVATAR_CHAT_MODEL": "m", "ECHOAVATAR_PERSONA": "/nowhere"},
            "cannot be read",
        ),
    ],
)
def test_mistakes_are_said(given: dict[str, str], remedy: str) -> None:
    with pytest.raises(EchoAvatarError, match=remedy):
        from_environment(given)


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("ECHOAVATAR_CHAT_URL", raising=False)
        patch.setattr(companion, "LOCAL_SERVERS", {})
        patch.setattr(companion, "find_ears", lambda _: None)
        with serving() as server:
            yield server


def test_the_companion_is_named(server: RunningServer) -> None:
    status, told = server.http("/v1/chat")
    assert (status, told.pop("install")) == (200, "pip install 'echoavatar[ears]'")
    assert told == {"name": "script", "where": "", "hears": ""}


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


def test_ears_of_this_machine_hear_for_the_script(server: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(companion, "find_ears", lambda _: Ears("whisper", lambda wav: wav.decode().lower()))
    assert server.http("/v1/chat")[1]["hears"] == "whisper"
    assert server.http("/v1/chat/ears", b"WAVE", content_type="audio/wav") == (200, {"text": "wave"})


def test_without_ears_nothing_is_transcribed(server: RunningServer) -> None:
    status, answer = server.http("/v1/chat/ears", b"RIFF", content_type="audio/wav")
    assert (status, "ECHOAVATAR_CHAT_EARS" in answer["error"]) == (400, True)
    assert server.http("/v1/chat/ears", b"RIFF", content_type="text/plain")[0] == 400
    assert server.http("/v1/chat/ears", bytes(MOST_SOUND + 1), content_type="audio/wav")[0] == 400
    assert server.http("/v1/chat/ears", b"RIFF", content_type="audio/wav", origin="https://evil.example")[0] == 403
