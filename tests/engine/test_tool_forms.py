"""Every framework's documented shape; where its package is installed, its own types say so."""

import importlib.util
from pathlib import Path
from typing import Any, get_args

import pytest
from tests.engine.test_tools import LIBRARY

from echoavatar.engine.tool_forms import Style
from echoavatar.engine.tools import Toolbox
from echoavatar.engine.tracks import Tracks

NAMES = ["send_action", "play_music", "stop_music", "list_actions"]


@pytest.fixture(scope="module")
def toolbox(tmp_path_factory: pytest.TempPathFactory) -> Toolbox:
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


def test_openai_takes_them(toolbox: Toolbox) -> None:
    """Function calling guide: flat for Realtime and Responses, nested for Chat Completions."""
    for tool in toolbox.schemas("openai"):
        assert set(tool) == {"type", "name", "description", "parameters"}
        assert tool["type"] == "function"
        check_schema(tool["parameters"])
    for tool in toolbox.schemas("openai-chat"):
        assert set(tool) == {"type", "function"}
        assert tool["function"]["name"] in NAMES


@pytest.mark.skipif(not has("openai"), reason="openai is not installed")
def test_openai_says_so_itself(toolbox: Toolbox) -> None:
    from openai.types.chat import ChatCompletionFunctionToolParam
    from openai.types.realtime import RealtimeFunctionTool, SessionUpdateEvent
    from pydantic import TypeAdapter

    tools = toolbox.schemas("openai")
    for tool in tools:
        assert RealtimeFunctionTool.model_validate(tool, strict=True).to_dict() == tool
    event = {"type": "session.update", "session": {"type": "realtime", "tools": tools}}
    assert [
        tool.name
        for tool in SessionUpdateEvent.model_validate(event).session.tools  # type: ignore[union-attr]
    ] == NAMES
    TypeAdapter(list[ChatCompletionFunctionToolParam]).validate_python(toolbox.schemas("openai-chat"))


def test_anthropic_takes_them(toolbox: Toolbox) -> None:
    """https://docs.anthropic.com/en/docs/build-with-claude/tool-use."""
    for tool in toolbox.schemas("anthropic"):
        assert set(tool) == {"name", "description", "input_schema"}
        check_schema(tool["input_schema"])


@pytest.mark.skipif(not has("anthropic"), reason="anthropic is not installed")
def test_anthropic_says_so_itself(toolbox: Toolbox) -> None:
    from anthropic.types import ToolParam
    from pydantic import TypeAdapter

    TypeAdapter(list[ToolParam]).validate_python(toolbox.schemas("anthropic"))


def test_gemini_takes_them(toolbox: Toolbox) -> None:
    """https://ai.google.dev/gemini-api/docs/function-calling: an OpenAPI subset, and none at all for no parameters."""
    [tool] = toolbox.schemas("gemini")
    assert [declared["name"] for declared in tool["function_declarations"]] == NAMES
    known = {"type", "properties", "required", "description", "enum", "minimum", "maximum"}
    for declared in tool["function_declarations"]:
        parameters = declared.get("parameters", {"type": "object", "properties": {"-": {}}})
        assert parameters["properties"]
        assert set(parameters) <= known
        assert all(set(what) <= known for what in parameters["properties"].values())


@pytest.mark.skipif(not has("google.genai"), reason="google-genai is not installed")
def test_gemini_says_so_itself(toolbox: Toolbox) -> None:
    from google.genai import types

    [tool] = toolbox.schemas("gemini")
    read = types.Tool.model_validate(tool)
    assert [declared.name for declared in read.function_declarations or []] == NAMES


def test_elevenlabs_takes_them(toolbox: Toolbox) -> None:
    """POST /v1/convai/tools: of a property's sources of value exactly one, here the description; no bounds."""
    for tool in toolbox.schemas("elevenlabs"):
        config = tool["tool_config"]
        assert set(tool) == {"tool_config"}
        assert config["type"] == "client"
        assert config["expects_response"] == (config["name"] == "list_actions")
        for what in config.get("parameters", {"properties": {}})["properties"].values():
            assert set(what) <= {"type", "description", "enum"}
    intensity = toolbox.schemas("elevenlabs")[0]["tool_config"]["parameters"]["properties"]["intensity"]
    assert "From 0 to 2." in intensity["description"]


@pytest.mark.skipif(not has("elevenlabs"), reason="elevenlabs is not installed")
def test_elevenlabs_says_so_itself(toolbox: Toolbox) -> None:
    from elevenlabs.types import ToolRequestModel

    for tool in toolbox.schemas("elevenlabs"):
        read = ToolRequestModel.model_validate(tool)
        assert read.tool_config.name == tool["tool_config"]["name"]  # type: ignore[union-attr]


def test_pipecat_takes_them(toolbox: Toolbox) -> None:
    """`FunctionSchema(**tool)`."""
    for tool in toolbox.schemas("pipecat"):
        assert set(tool) == {"name", "description", "properties", "required"}


@pytest.mark.skipif(not has("pipecat"), reason="pipecat is not installed")
def test_pipecat_says_so_itself(toolbox: Toolbox) -> None:
    from pipecat.adapters.llm.schemas.function_schema import FunctionSchema

    plain = toolbox.schemas("plain")
    for tool, same in zip(toolbox.schemas("pipecat"), plain, strict=True):
        read = FunctionSchema(**tool)
        assert (read.name, read.required) == (same["name"], same["parameters"]["required"])


def test_livekit_takes_them(toolbox: Toolbox) -> None:
    """`function_tool(raw_schema=tool)`: a name, and parameters even where there are none."""
    for tool in toolbox.schemas("livekit"):
        assert set(tool) == {"name", "description", "parameters"}
        check_schema(tool["parameters"])


@pytest.mark.skipif(not has("livekit.agents"), reason="livekit-agents is not installed")
def test_livekit_says_so_itself(toolbox: Toolbox) -> None:
    from livekit.agents import function_tool

    async def do(raw_arguments: dict[str, object]) -> None: ...

    for tool in toolbox.schemas("livekit"):
        assert function_tool(do, raw_schema=tool).info.name == tool["name"]


def test_mcp_takes_them(toolbox: Toolbox) -> None:
    for tool in toolbox.schemas("mcp"):
        assert set(tool) == {"name", "description", "inputSchema"}
        check_schema(tool["inputSchema"])


@pytest.mark.parametrize("style", get_args(Style))
def test_forms_share_nothing_that_could_be_changed_by_accident(toolbox: Toolbox, style: Style) -> None:
    toolbox.schemas(style)[0].clear()
    assert toolbox.schemas(style)[0]
