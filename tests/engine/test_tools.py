import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.engine.fakes import engine

from echoavatar.engine import SessionCore
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.engine.tools import Toolbox
from echoavatar.engine.tracks import Tracks

LIBRARY = ActionLibrary({name: Action(name, (1, 2, 3, 4), (0, 1), f"to {name}") for name in ("wave", "bow", "listen")})


@pytest.fixture
def toolbox(tmp_path: Path) -> Toolbox:
    soundfile.write(tmp_path / "My_Tune.wav", np.full(24_000, 0.1, np.float32), 24_000)
    return Toolbox(LIBRARY, Tracks(tmp_path))


@pytest.fixture
def session() -> SessionCore:
    machine = engine()
    machine.actions = LIBRARY
    return machine.open_core()


def test_a_model_waves_and_hears_what_became_of_it(toolbox: Toolbox, session: SessionCore) -> None:
    answer = toolbox.call(session, "send_action", {"action": "wave", "intensity": 1.5, "hold": None})
    assert answer["status"] == "accepted"
    assert [status.name for status in session.take_statuses()] == ["wave"]


@pytest.mark.parametrize(
    ("name", "arguments", "reason"),
    [
        ("send_action", {"action": "moonwalk"}, "there are: wave, bow"),
        ("send_action", {}, "needs 'action'"),
        ("send_action", {"action": "wave", "intensity": "much"}, "must be a number"),
        ("send_action", {"action": "wave", "speed": 2}, "knows no 'speed'"),
        ("send_action", {"action": "wave", "intensity": 5}, "intensity 5"),
        ("send_action", {"action": "wave", "intensity": 10**400}, "must be a number"),
        ("send_action", {"action": "wave", "hold": float("nan")}, "must be a number"),
        ("play_music", {"title": "Silence"}, "My Tune"),
        ("fly", {}, "there are: send_action"),
    ],
)
def test_what_cannot_be_is_rejected_with_the_reason(
    toolbox: Toolbox, session: SessionCore, name: str, arguments: dict[str, object], reason: str
) -> None:
    answer = toolbox.call(session, name, arguments)
    assert answer["status"] == "rejected"
    assert reason in answer["reason"]


def test_music_is_heard_by_the_session_and_stops(toolbox: Toolbox, session: SessionCore) -> None:
    assert toolbox.call(session, "play_music", {"title": "my_tune"}) == {"status": "accepted", "title": "My Tune"}
    session._host.tick()
    delivery = session.take()
    assert delivery is not None
    assert delivery.source == "music"
    np.testing.assert_allclose(delivery.audio, 0.1, atol=1e-3)
    assert toolbox.call(session, "stop_music", {}) == {"status": "done"}
    for _ in range(3):
        session._host.tick()
    assert not session.is_ready


def test_only_real_actions_are_offered_and_what_it_does_by_itself_is_not(
    toolbox: Toolbox, session: SessionCore
) -> None:
    offered = toolbox.schemas()[0]["parameters"]["properties"]["action"]["enum"]
    assert offered == ["wave", "bow"]
    assert toolbox.call(session, "list_actions", {}) == {"actions": {"wave": "to wave", "bow": "to bow"}}


@pytest.mark.parametrize("style", ["plain", "openai", "openai-chat", "anthropic", "gemini", "mcp"])
def test_every_framework_gets_its_form(toolbox: Toolbox, style: str) -> None:
    schemas = toolbox.schemas(style)  # type: ignore[arg-type]
    text = json.dumps(schemas)
    assert all(f'"{name}"' in text for name in ("send_action", "play_music", "stop_music", "list_actions"))
    where = {
        "plain": lambda s: s[0]["parameters"],
        "openai": lambda s: s[0]["parameters"],
        "openai-chat": lambda s: s[0]["function"]["parameters"],
        "anthropic": lambda s: s[0]["input_schema"],
        "gemini": lambda s: s[0]["function_declarations"][0]["parameters"],
        "mcp": lambda s: s[0]["inputSchema"],
    }[style]
    assert where(schemas)["required"] == ["action"]
    assert ("additionalProperties" in text) == (style != "gemini")
