"""What the scripted companion says and does at a phrase, and at any other text."""

import asyncio
from typing import Any

import pytest

from echoavatar.server.script import ACTION_LINES, CUES, FALLBACKS, ChatTurn, Scripted, ToolAccess

TOOLS = [
    {
        "type": "function",
        "function": {
            "name": name,
            "parameters": {"type": "object", "properties": {argument: {"type": "string", "enum": list(values)}}},
        },
    }
    for name, argument, values in (
        ("send_action", "action", ("wave", "bow", "point_left", "give_up", "thinking", "agree", "look_around")),
        ("play_music", "title", ("Bright House", "Evening Waltz")),
    )
]


def say(text: str, turns: int = 0) -> tuple[str, list[tuple[str, dict[str, Any]]]]:
    did: list[tuple[str, dict[str, Any]]] = []

    async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        did.append((name, arguments))
        return {"status": "accepted"}

    history = [ChatTurn("user", "...")] * (2 * turns)
    return asyncio.run(Scripted().reply(text, history, ToolAccess(TOOLS, do))), did


@pytest.mark.parametrize(
    ("text", "did"),
    [
        ("Hello there!", [("send_action", {"action": "wave"})]),
        ("Please point left for me", [("send_action", {"action": "point_left"})]),
        ("just SHRUG", [("send_action", {"action": "give_up"})]),
        ("play the evening waltz", [("play_music", {"title": "Evening Waltz"})]),
        ("some music please", [("play_music", {})]),
        ("stop the music", [("stop_music", {})]),
        ("tell me something I can interrupt", []),
        ("xyzzy", [("send_action", {"action": "thinking"})]),
    ],
)
def test_words_become_deeds(text: str, did: list[tuple[str, dict[str, str]]]) -> None:
    line, done = say(text)
    assert done == did
    assert line


def test_it_does_not_repeat_itself_at_once_and_goes_the_same_way_twice() -> None:
    assert say("xyzzy", 0) != say("xyzzy", 1)
    assert say("xyzzy", 1) == say("xyzzy", 1)


def test_what_it_does_not_understand_it_answers_with_what_it_can_do() -> None:
    """Each deed that the answer names is done when it is asked for."""
    for turn in range(len(FALLBACKS)):
        line, _ = say("xyzzy", turn)
        deeds = ("wave", "nod", "bow", "clap", "think", "look around", "music", "stop")
        named = [word for word in deeds if word in line]
        assert len(named) >= 4
        assert all(say(word, 0)[1] for word in named)


def test_it_says_what_it_is() -> None:
    assert "script" in say("who are you?")[0]


def test_lines_fit_a_voice_and_are_spoken_english() -> None:
    lines = [line for cue in CUES for line in cue.lines] + list(ACTION_LINES) + [line for line, _ in FALLBACKS]
    assert all(0 < len(line) <= 600 for line in lines)
    assert all(line.isascii() and line[-1] in ".!?" for line in lines)


def test_without_actions_it_only_talks() -> None:
    async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        return {"status": "rejected"}

    assert asyncio.run(Scripted().reply("wave", [], ToolAccess([], do)))
