import json

from tests.server.fakes import Body

from echoavatar.engine import Engine
from echoavatar.server.tools import tool_schemas


def test_names_come_from_the_library() -> None:
    tools = {tool["name"]: tool for tool in tool_schemas(Engine(Body()), ("Evening",))}  # type: ignore[arg-type]
    assert set(tools) == {"send_action", "play_music", "stop_music", "list_actions"}
    action = tools["send_action"]["parameters"]
    assert action["properties"]["action"]["enum"] == ["wave", "bow"]
    assert action["required"] == ["action"]
    assert tools["play_music"]["parameters"]["properties"]["title"]["enum"] == ["Evening"]
    assert all(tool["description"] for tool in tools.values())
    json.dumps(tools)
