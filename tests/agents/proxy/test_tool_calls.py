import asyncio
import json
from typing import Any

import pytest

from echoavatar.agents.proxy.events import Event
from echoavatar.agents.proxy.tool_calls import ToolCalls

OURS = [
    {"type": "function", "name": name, "description": f"to {name}", "parameters": {}}
    for name in ("send_action", "list_actions")
]


class FakeSession:
    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.did: list[tuple[str, dict[str, Any]]] = []
        self.calls = ToolCalls(self.send, self.do)
        self.calls.declared = OURS

    async def send(self, event: dict[str, Any]) -> None:
        self.sent.append(event)

    async def do(self, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        self.did.append((name, arguments))
        return {"status": "accepted"}

    async def response(self, *names: str, words: bool = False, arguments: Any = "{}", id: str = "r") -> None:
        output = [{"type": "message"}] if words else []
        for k, name in enumerate(names):
            item = {"type": "function_call", "name": name, "call_id": f"{id}{k}", "arguments": arguments}
            output.append(item)
            self.calls.on_model_event(Event("response.output_item.done", response_id=id, item=item))
            self.calls.on_model_event(
                Event(
                    "response.function_call_arguments.done",
                    response_id=id,
                    call_id=f"{id}{k}",
                    name=name,
                    arguments=arguments,
                )
            )
        done = {"id": id, "status": "completed", "output": output}
        self.calls.on_model_event(Event("response.done", response=done))
        await asyncio.sleep(0.01)

    @property
    def kinds(self) -> list[str]:
        return [event["type"] for event in self.sent]


@pytest.mark.parametrize(
    ("names", "words", "kinds"),
    [
        (["send_action"], True, ["conversation.item.create"]),  # a gesture beside words needs no answer
        (["send_action"], False, ["conversation.item.create", "response.create"]),
        (["list_actions"], True, ["conversation.item.create", "response.create"]),
        (["theirs"], False, []),
        (["send_action", "theirs"], False, ["conversation.item.create"]),  # the client will continue the conversation
    ],
)
async def test_calls_are_answered_once_and_the_model_continues_only_if_it_was_silent(
    names: list[str], words: bool, kinds: list[str]
) -> None:
    session = FakeSession()
    await session.response(*names, words=words)
    assert session.kinds == kinds
    assert len(session.did) == sum(name != "theirs" for name in names)


async def test_a_model_that_only_calls_is_not_asked_for_ever() -> None:
    session = FakeSession()
    for turn in range(4):
        await session.response("send_action", id=f"r{turn}")
    assert session.kinds.count("response.create") == 2
    session.calls.on_user_turn()
    await session.response("send_action", id="later")
    assert session.kinds.count("response.create") == 3


async def test_arguments_may_come_as_an_object() -> None:
    session = FakeSession()
    await session.response("send_action", words=True, arguments={"action": "wave"})
    assert session.did == [("send_action", {"action": "wave"})]


@pytest.mark.parametrize("arguments", ["[1", "[1]", '{"action": "\\ud800"}', "[" * 4500, 7])
async def test_invalid_arguments_are_rejected(arguments: Any) -> None:
    session = FakeSession()
    await session.response("send_action", words=True, arguments=arguments)
    assert json.loads(session.sent[0]["item"]["output"])["status"] == "rejected"
    assert not session.did


async def test_the_avatars_tools_are_added_and_the_clients_tools_win() -> None:
    session = FakeSession()
    own = {"type": "function", "name": "send_action", "description": "mine"}
    session.calls.on_session({"type": "realtime", "tools": [own]}, is_first=True)
    await session.calls.offer()
    await session.calls.offer()
    [update] = session.sent
    assert update["session"] == {"tools": [own, OURS[1]], "type": "realtime"}
    await session.response("send_action")
    assert not session.did


async def test_the_first_protocol_is_not_told_a_type() -> None:
    session = FakeSession()
    session.calls.on_session({"tools": []}, is_first=True)
    await session.calls.offer()
    assert set(session.sent[0]["session"]) == {"tools"}
