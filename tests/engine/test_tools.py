import importlib.util
import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import soundfile

from echoavatar.engine.music import Tracks
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.engine.tools import Style, Toolbox

LIBRARY = ActionLibrary({name: Action(name, (1, 2, 3, 4), (0, 1), f"to {name}") for name in ("wave", "bow", "listen")})
NAMES = ["send_action", "play_music", "stop_music", "list_actions"]


@pytest.fixture
def toolbox(tmp_path: Path) -> Toolbox:
    soundfile.write(tmp_path / "My_Tune.wav", np.tile(np.float32([0.1, -0.1]), 12_000), 24_000)
    return Toolbox(LIBRARY, Tracks(tmp_path))


def test_only_real_actions_are_offered_and_what_it_does_by_itself_is_not(toolbox: Toolbox) -> None:
    offered = toolbox.schemas()[0]["parameters"]["properties"]["action"]["enum"]
    assert offered == ["wave", "bow"]
    assert toolbox.meanings == {"wave": "to wave", "bow": "to bow"}


def test_a_manner_is_offered_where_the_model_follows_it(tmp_path: Path) -> None:
    toolbox = Toolbox(LIBRARY, Tracks(tmp_path), has_manner=True)
    assert [tool["name"] for tool in toolbox.schemas()] == ["send_action", "set_manner", *NAMES[1:]]


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


@pytest.fixture(scope="module")
def full_toolbox(tmp_path_factory: pytest.TempPathFactory) -> Toolbox:
    return Toolbox(LIBRARY, Tracks(Path(tmp_path_factory.mktemp("music"))))


def has(package: str) -> bool:
    try:
        return importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:
        return False


def check_schema(schema: dict[str, Any]) -> None:
    """JSON Schema as all of them want it: an object whose properties have types and whose required ones exist."""
    assert schema["type"] == "object"
    assert set(schema["required"]) <= set(schema["properties"])
    for what in schema["properties"].values():
        assert what["type"] in ("string", "number")
        assert what["description"]
    if has("jsonschema"):
        import jsonschema

        jsonschema.Draft202012Validator.check_schema(schema)


def test_openai_takes_them(full_toolbox: Toolbox) -> None:
    """Function calling guide: flat for Realtime and Responses, nested for Chat Completions."""
    for tool in full_toolbox.schemas("openai"):
        assert set(tool) == {"type", "name", "description", "parameters"}
        assert tool["type"] == "function"
        check_schema(tool["parameters"])
    for tool in full_toolbox.schemas("openai-chat"):
        assert set(tool) == {"type", "function"}
        assert tool["function"]["name"] in NAMES


@pytest.mark.skipif(not has("openai"), reason="openai is not installed")
def test_openai_says_so_itself(full_toolbox: Toolbox) -> None:
    from openai.types.chat import ChatCompletionFunctionToolParam
    from openai.types.realtime import RealtimeFunctionTool, SessionUpdateEvent
    from pydantic import TypeAdapter

    tools = full_toolbox.schemas("openai")
    for tool in tools:
        assert RealtimeFunctionTool.model_validate(tool, strict=True).to_dict() == tool
    event = {"type": "session.update", "session": {"type": "realtime", "tools": tools}}
    assert [
        tool.name
        for tool in SessionUpdateEvent.model_validate(event).session.tools  # type: ignore[union-attr]
    ] == NAMES
    TypeAdapter(list[ChatCompletionFunctionToolParam]).validate_python(full_toolbox.schemas("openai-chat"))


def test_anthropic_takes_them(full_toolbox: Toolbox) -> None:
    """https://docs.anthropic.com/en/docs/build-with-claude/tool-use."""
    for tool in full_toolbox.schemas("anthropic"):
        assert set(tool) == {"name", "description", "input_schema"}
        check_schema(tool["input_schema"])


@pytest.mark.skipif(not has("anthropic"), reason="anthropic is not installed")
def test_anthropic_says_so_itself(full_toolbox: Toolbox) -> None:
    from anthropic.types import ToolParam
    from pydantic import TypeAdapter

    TypeAdapter(list[ToolParam]).validate_python(full_toolbox.schemas("anthropic"))


def test_gemini_takes_them(full_toolbox: Toolbox) -> None:
    """https://ai.google.dev/gemini-api/docs/function-calling: an OpenAPI subset, and none at all for no parameters."""
    [tool] = full_toolbox.schemas("gemini")
    assert [declared["name"] for declared in tool["function_declarations"]] == NAMES
    known = {"type", "properties", "required", "description", "enum", "minimum", "maximum"}
    for declared in tool["function_declarations"]:
        parameters = declared.get("parameters", {"type": "object", "properties": {"-": {}}})
        assert parameters["properties"]
        assert set(parameters) <= known
        assert all(set(what) <= known for what in parameters["properties"].values())


@pytest.mark.skipif(not has("google.genai"), reason="google-genai is not installed")
def test_gemini_says_so_itself(full_toolbox: Toolbox) -> None:
    from google.genai import types

    [tool] = full_toolbox.schemas("gemini")
    read = types.Tool.model_validate(tool)
    assert [declared.name for declared in read.function_declarations or []] == NAMES


def test_elevenlabs_takes_them(full_toolbox: Toolbox) -> None:
    """POST /v1/convai/tools: of a property's sources of value exactly one, here the description; no bounds."""
    for tool in full_toolbox.schemas("elevenlabs"):
        config = tool["tool_config"]
        assert set(tool) == {"tool_config"}
        assert config["type"] == "client"
        assert config["expects_response"] == (config["name"] == "list_actions")
        for what in config.get("parameters", {"properties": {}})["properties"].values():
            assert set(what) <= {"type", "description", "enum"}
    intensity = full_toolbox.schemas("elevenlabs")[0]["tool_config"]["parameters"]["properties"]["intensity"]
    assert "From 0 to 2." in intensity["description"]


@pytest.mark.skipif(not has("elevenlabs"), reason="elevenlabs is not installed")
def test_elevenlabs_says_so_itself(full_toolbox: Toolbox) -> None:
    from elevenlabs.types import ToolRequestModel

    for tool in full_toolbox.schemas("elevenlabs"):
        read = ToolRequestModel.model_validate(tool)
        assert read.tool_config.name == tool["tool_config"]["name"]  # type: ignore[union-attr]


def test_pipecat_takes_them(full_toolbox: Toolbox) -> None:
    """`FunctionSchema(**tool)`."""
    for tool in full_toolbox.schemas("pipecat"):
        assert set(tool) == {"name", "description", "properties", "required"}


@pytest.mark.skipif(not has("pipecat"), reason="pipecat is not installed")
def test_pipecat_says_so_itself(full_toolbox: Toolbox) -> None:
    from pipecat.adapters.llm.schemas.function_schema import FunctionSchema

    plain = full_toolbox.schemas("plain")
    for tool, same in zip(full_toolbox.schemas("pipecat"), plain, strict=True):
        read = FunctionSchema(**tool)
        assert (read.name, read.required) == (same["name"], same["parameters"]["required"])


def test_livekit_takes_them(full_toolbox: Toolbox) -> None:
    """`function_tool(raw_schema=tool)`: a name, and parameters even where there are none."""
    for tool in full_toolbox.schemas("livekit"):
        assert set(tool) == {"name", "description", "parameters"}
        check_schema(tool["parameters"])


@pytest.mark.skipif(not has("livekit.agents"), reason="livekit-agents is not installed")
def test_livekit_says_so_itself(full_toolbox: Toolbox) -> None:
    from livekit.agents import function_tool

    async def do(raw_arguments: dict[str, object]) -> None: ...

    for tool in full_toolbox.schemas("livekit"):
        assert function_tool(do, raw_schema=tool).info.name == tool["name"]


def test_mcp_takes_them(full_toolbox: Toolbox) -> None:
    for tool in full_toolbox.schemas("mcp"):
        assert set(tool) == {"name", "description", "inputSchema"}
        check_schema(tool["inputSchema"])


@pytest.mark.parametrize("style", get_args(Style))
def test_forms_share_nothing_that_could_be_changed_by_accident(full_toolbox: Toolbox, style: Style) -> None:
    full_toolbox.schemas(style)[0].clear()
    assert full_toolbox.schemas(style)[0]
