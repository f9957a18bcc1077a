"""What both kinds of companion are given and offer."""

import pytest

from echoavatar.server.companion import ChatModel, Companion, Scripted, ToolAccess


async def _refuse(name: str, arguments: dict[str, object]) -> dict[str, object]:
    return {"status": "rejected"}


def _tool(name: str, argument: str, **schema: object) -> dict[str, object]:
    return {"function": {"name": name, "parameters": {"properties": {argument: schema}}}}


def test_choices_are_the_values_that_a_tool_declares() -> None:
    doing = ToolAccess([_tool("play_music", "title", enum=["Waltz"]), _tool("send_action", "action")], _refuse)
    assert doing.choices("play_music", "title") == ["Waltz"]
    assert doing.choices("send_action", "action") == []
    assert doing.choices("stop_music", "title") == []


@pytest.mark.parametrize("companion", [Scripted(), ChatModel("http://127.0.0.1:9/v1", model="m")])
def test_both_kinds_are_companions(companion: Companion) -> None:
    assert companion.name
    assert not companion.hears
