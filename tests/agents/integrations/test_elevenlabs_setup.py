"""The setup, run twice against a service that keeps state: created, then updated, never duplicated."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
from tests.http_server import Handler, HttpServer, running

from echoavatar.agents.integrations.elevenlabs_setup import carry_out, make_plan
from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.engine.tools import Toolbox
from echoavatar.errors import EchoAvatarError


class Service(HttpServer):
    """ElevenLabs' API of tools and agents."""

    def __init__(self) -> None:
        super().__init__(self._answer)
        self.tools: dict[str, Any] = {}
        self.agents: dict[str, Any] = {}

    def _answer(self, handler: Handler) -> None:
        path, body = handler.path, json.loads(handler.body or b"{}")
        if handler.given["xi-api-key"] != "secret":
            return handler.answer(401, {"detail": "no such key"})
        if handler.command == "PATCH":
            kind, id = path.split("/")[-2:]
            known = {"tools": self.tools, "agents": self.agents}[kind]
            assert id in known
            known[id] = body
            return handler.answer(200, {})
        if handler.command == "POST" and path == "/v1/convai/tools":
            id = f"tool_{len(self.tools)}"
            self.tools[id] = body
            return handler.answer(200, {"id": id})
        if handler.command == "POST":
            assert path == "/v1/convai/agents/create"
            id = f"agent_{len(self.agents)}"
            self.agents[id] = body
            return handler.answer(200, {"agent_id": id})
        if path.startswith("/v1/convai/tools"):
            items = [{"id": id, **tool} for id, tool in self.tools.items()]
            at = 2 if "cursor=2" in path else 0
            more = len(items) > at + 2
            told = {"tools": items[at : at + 2], "has_more": more, "next_cursor": "2" if more else None}
            return handler.answer(200, told)
        items = [{"agent_id": id, "name": agent["name"]} for id, agent in self.agents.items()]
        return handler.answer(200, {"agents": items, "has_more": False})


@pytest.fixture
def service() -> Iterator[tuple[str, Service]]:
    with running(Service()) as there:
        yield there.url, there


def schemas(*names: str) -> list[dict[str, Any]]:
    actions = ActionLibrary({name: Action(name, (0,) * 8, (1, 2)) for name in names})
    return Toolbox(actions, Tracks()).schemas()


def test_setting_up_twice_updates_instead_of_duplicating(service: tuple[str, Service]) -> None:
    url, there = service
    plan = make_plan(schemas("wave"), "You are Echo.", name="idol", first_message="Hi!")
    agent_id, done = carry_out(plan, api_key="secret", base_url=url)
    assert agent_id == "agent_0"
    assert len(done) == 5
    assert all(line.startswith("created") for line in done)
    agent = there.agents["agent_0"]["conversation_config"]
    assert agent["agent"]["prompt"] == {"prompt": "You are Echo.", "tool_ids": list(there.tools)}
    assert agent["tts"] == {"agent_output_audio_format": "pcm_16000"}

    plan = make_plan(schemas("wave", "bow"), "You are another.", name="idol")
    again, done = carry_out(plan, api_key="secret", base_url=url)
    assert again == agent_id
    assert all(line.startswith("updated") for line in done)
    assert (len(there.tools), len(there.agents)) == (4, 1)
    action = there.tools["tool_0"]["tool_config"]["parameters"]["properties"]["action"]
    assert action["enum"] == ["wave", "bow"]


def test_an_agent_can_be_named_by_its_id(service: tuple[str, Service]) -> None:
    url, there = service
    there.agents["agent_7"] = {"name": "mine"}
    plan = make_plan(schemas("wave"), "Prompt.", name="another name")
    assert carry_out(plan, api_key="secret", agent_id="agent_7", base_url=url)[0] == "agent_7"
    assert list(there.agents) == ["agent_7"]


def test_only_tools_with_answers_make_the_model_wait() -> None:
    plan = make_plan(schemas("wave"), "", name="n")
    tools = {tool["tool_config"]["name"]: tool["tool_config"] for tool in plan.tools}
    assert [name for name, tool in tools.items() if tool["expects_response"]] == ["list_actions"]
    assert "parameters" not in tools["stop_music"]
    intensity = tools["send_action"]["parameters"]["properties"]["intensity"]
    assert set(intensity) == {"type", "description"}, "their schemas know no bounds"
    assert "From 0 to 2." in intensity["description"]


def test_failures_are_explained(service: tuple[str, Service]) -> None:
    plan = make_plan(schemas("wave"), "Prompt.", name="n")
    with pytest.raises(EchoAvatarError, match="API key"):
        carry_out(plan, api_key="wrong", base_url=service[0])
    with pytest.raises(EchoAvatarError, match="does not answer"):
        carry_out(plan, api_key="secret", base_url="http://127.0.0.1:9")
    with pytest.raises(EchoAvatarError, match="pcm_24000"):
        make_plan(schemas("wave"), "Prompt.", name="n", output_format="mp3")


def test_the_sdk_takes_the_same_requests(service: tuple[str, Service]) -> None:
    """Their models accept every payload, and their client sends it to the same addresses as ours."""
    elevenlabs = pytest.importorskip("elevenlabs", reason="pip install 'echoavatar[elevenlabs]'")
    url, there = service
    plan = make_plan(schemas("wave"), "Prompt.", name="idol")
    client = elevenlabs.ElevenLabs(api_key="secret", base_url=url)
    for tool in plan.tools:
        config = elevenlabs.ToolRequestModelToolConfig_Client(**tool["tool_config"])
        client.conversational_ai.tools.create(request=elevenlabs.ToolRequestModel(tool_config=config))
    theirs = [tool["tool_config"] for tool in there.tools.values()]
    assert theirs == [tool["tool_config"] for tool in plan.tools]
    config = elevenlabs.ConversationalConfig(**plan.agent["conversation_config"])
    client.conversational_ai.agents.create(conversation_config=config, name="idol")
    assert there.agents["agent_0"] == plan.agent


@pytest.mark.parametrize(
    "told",
    [
        {"tools": 3, "has_more": True, "next_cursor": "again"},
        {"tools": [{"id": "a"}]},
        {"tools": [{"id": 7, "tool_config": {"name": "send_action"}}]},
        {"tools": [{"id": "\x1b[31m", "tool_config": {"name": "send_action"}}]},
        {"tools": [{"id": "a" * 4_000, "tool_config": {"name": "send_action"}}]},
        {"tools": [{"id": "a", "tool_config": [1]}]},
        {"tools": None},
    ],
)
def test_a_service_that_answers_nonsense_is_one_error(told: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("echoavatar.outgoing.ask", lambda *_, **__: told)
    with pytest.raises(EchoAvatarError, match="is this ElevenLabs"):
        carry_out(make_plan(schemas("wave"), "", name="n"), api_key="secret")
