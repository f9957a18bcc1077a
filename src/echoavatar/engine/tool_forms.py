"""The tools' declarations in the form that each framework takes, made from the registry in `tools`.

Fields that a framework does not know are left out (`additionalProperties` for Gemini, bounds for ElevenLabs); only
fields that it requires are added. A gesture needs no comment by the model, so ElevenLabs is told to expect a response
from the tools in `TELLING` only.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

Schema = dict[str, Any]
Style = Literal["plain", "openai", "openai-chat", "anthropic", "gemini", "mcp", "elevenlabs", "pipecat", "livekit"]
TELLING = ("list_actions",)  # tools whose answer the model needs


def render(style: Style, plain: Sequence[Schema]) -> list[Schema]:
    """Declarations (`name`, `description`, `parameters`) in a framework's form.

    plain: as given; openai: Realtime and Responses; openai-chat: Chat Completions; anthropic: Messages; gemini: one
    tool with its function declarations; mcp: Model Context Protocol; elevenlabs: requests that create client tools;
    pipecat: arguments of `FunctionSchema`; livekit: `raw_schema` of `function_tool`.
    """
    if style == "gemini":
        return [{"function_declarations": [_gemini(tool) for tool in plain]}]
    return [_FORMS[style](tool) for tool in plain]


def _gemini(tool: Schema) -> Schema:
    """Gemini takes no `additionalProperties`, and no empty `parameters`."""
    if not tool["parameters"]["properties"]:
        return {"name": tool["name"], "description": tool["description"]}
    kept = {key: value for key, value in tool["parameters"].items() if key != "additionalProperties"}
    return tool | {"parameters": kept}


def _elevenlabs(tool: Schema) -> Schema:
    """ElevenLabs takes no bounds, so the description states them."""
    parameters = tool["parameters"]
    config = {
        "type": "client",
        "name": tool["name"],
        "description": tool["description"],
        "expects_response": tool["name"] in TELLING,
    }
    if parameters["properties"]:
        properties = {name: _literal(what) for name, what in parameters["properties"].items()}
        config["parameters"] = {"type": "object", "required": parameters["required"], "properties": properties}
    return {"tool_config": config}


def _literal(what: Mapping[str, Any]) -> Schema:
    kept = {key: what[key] for key in ("type", "description", "enum") if key in what}
    if "maximum" in what:
        kept["description"] += f" From {what['minimum']:g} to {what['maximum']:g}."
    return kept


def _pipecat(tool: Schema) -> Schema:
    return {
        "name": tool["name"],
        "description": tool["description"],
        "properties": tool["parameters"]["properties"],
        "required": tool["parameters"]["required"],
    }


def _renamed(key: str) -> Callable[[Schema], Schema]:
    return lambda tool: {"name": tool["name"], "description": tool["description"], key: tool["parameters"]}


_FORMS: Mapping[str, Callable[[Schema], Schema]] = {
    "plain": dict,
    "openai": lambda tool: {"type": "function", **tool},
    "openai-chat": lambda tool: {"type": "function", "function": dict(tool)},
    "anthropic": _renamed("input_schema"),
    "mcp": _renamed("inputSchema"),
    "elevenlabs": _elevenlabs,
    "pipecat": _pipecat,
    "livekit": dict,
}
