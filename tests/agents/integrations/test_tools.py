"""A model's calls, through a bridge that only records them."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from echoavatar.agents.integrations import AvatarTools
from echoavatar.agents.integrations.tools import persona
from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.engine.tools import Toolbox
from echoavatar.wire.messages import ActionStatus


class AvatarBridge:
    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.ready = SimpleNamespace(actions=("wave",), tracks=("Waltz",))

    async def act(self, name: str, *, intensity: float, hold: float | None) -> ActionStatus:
        self.asked.append((name, intensity, hold))
        return ActionStatus(id="1", name=name, status="accepted", at=0, reason="", choices=())

    async def set_manner(self, **told: float) -> None:
        self.asked.append(told)

    async def play_music(self, title: str) -> ActionStatus:
        self.asked.append(title)
        return ActionStatus(id="2", name=title, status="rejected", at=0, reason="no", choices=("Waltz",))

    async def stop_music(self) -> None:
        self.asked.append("stop")


@pytest.fixture
def tools() -> AvatarTools:
    library = ActionLibrary({"wave": Action("wave", (0,) * 8, (1, 2))})
    return AvatarTools(AvatarBridge(), Toolbox(library, Tracks(), has_manner=True).schemas())  # type: ignore[arg-type]


def call(tools: AvatarTools, name: str, **arguments: Any) -> dict[str, Any]:
    return asyncio.run(tools.call(name, arguments))


def test_calls_reach_the_stage(tools: AvatarTools) -> None:
    assert call(tools, "send_action", action="wave", intensity=2) == {"action": "wave", "status": "accepted"}
    assert call(tools, "send_action", action="wave", hold=None)["status"] == "accepted"
    assert call(tools, "set_manner", liveliness=0.2) == {"status": "done"}
    told = call(tools, "play_music", title="Rock")
    assert told == {"title": "Rock", "status": "rejected", "reason": "no", "choices": ["Waltz"]}
    assert call(tools, "stop_music") == {"status": "done"}
    assert call(tools, "list_actions") == {"actions": ["wave"], "music": ["Waltz"]}
    bridge: Any = tools._bridge
    assert bridge.asked == [("wave", 2.0, None), ("wave", 1.0, None), {"liveliness": 0.2}, "Rock", "stop"]


@pytest.mark.parametrize(
    ("name", "arguments", "reason"),
    [
        ("dive", {}, "there are: send_action"),
        ("send_action", {}, "needs 'action'"),
        ("send_action", {"action": 3}, "a string"),
        ("send_action", {"action": "wave", "speed": 1}, "knows no 'speed'"),
        ("send_action", {"action": "wave", "intensity": "much"}, "a number"),
        ("send_action", {"action": "wave", "intensity": True}, "a number"),
        ("send_action", {"action": "wave", "hold": 1e9}, "a number from 0 to 60"),
    ],
)
def test_invalid_calls_are_rejected_not_raised(
    tools: AvatarTools, name: str, arguments: dict[str, Any], reason: str
) -> None:
    told = call(tools, name, **arguments)
    assert told["status"] == "rejected"
    assert reason in told["reason"]


def test_the_prompt_lists_actions_and_tracks() -> None:
    text = persona(["wave", "bow"], ["Waltz"], name="Mika", surroundings="The record store is on the right.")
    for told in ("Mika", "wave, bow", "Waltz", "record store", "Producer", "send_action", "play_music", "stop_music"):
        assert told in text
    assert "{" not in text


def test_the_prompt_says_if_there_are_none() -> None:
    assert "none yet" in persona([], [])
