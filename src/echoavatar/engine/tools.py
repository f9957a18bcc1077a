"""Tools for language models: what a model may do with the avatar, declared in the form of every framework.

The schemas' enums come from the live libraries, so a model is only offered gestures and tracks that exist. A call that
asks for another one is rejected, and the reason lists those that exist.

`render` makes the declarations in the form that each framework takes. Fields that a framework does not know are left
out (`additionalProperties` for Gemini, bounds for ElevenLabs); only fields that it requires are added. A gesture needs
no comment by the model, so ElevenLabs is told to expect a response from the tools in `TELLING` only.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from echoavatar.engine.pipeline.actions import LONGEST_S, ActionLibrary
from echoavatar.errors import EchoAvatarError

from .action_scheduler import STRONGEST
from .music import Tracks

HIDDEN = ("listen", "nod")  # actions that the avatar does by itself
Schema = dict[str, Any]
Style = Literal["plain", "openai", "openai-chat", "anthropic", "gemini", "mcp", "elevenlabs", "pipecat", "livekit"]
TELLING = ("list_actions",)  # tools whose answer the model needs


class Toolbox:
    """The tools over one action library and one music library."""

    def __init__(self, actions: ActionLibrary, tracks: Tracks, *, has_manner: bool = False) -> None:
        """`has_manner`: whether the motion model follows a manner, so that `set_manner` is offered."""
        self._tracks, self._has_manner = tracks, has_manner
        self.meanings = {name: action.about for name, action in actions.items() if name not in HIDDEN}

    def schemas(self, style: Style = "plain") -> list[Schema]:
        """Declarations in a framework's form, see `render`; their enums are those of the libraries now."""
        meanings = "; ".join(f"{name}: {about}" for name, about in self.meanings.items())
        action = {"type": "string", "enum": list(self.meanings), "description": f"What to do. {meanings}"}
        intensity = _number("How strongly; 1 is normal.", STRONGEST)
        hold = _number("Seconds to hold it; left out, it takes its natural time.", LONGEST_S)
        title: Schema = {"type": "string", "description": "Left out, the first one plays."}
        if self._tracks.titles:
            title["enum"] = list(self._tracks.titles)
        plain = [
            _tool(
                "send_action",
                "Let the avatar do a gesture now, while it speaks or in silence. It ends by itself.",
                {"action": action, "intensity": intensity, "hold": hold},
                ["action"],
            ),
            _tool(
                "play_music",
                "Play music; the avatar hears it and dances. It goes on until its end or stop_music.",
                {"title": title},
            ),
            _tool("stop_music", "Fade the music out.", {}),
            _tool("list_actions", "Name the gestures the avatar can do.", {}),
        ]
        if self._has_manner:
            liveliness = _number("0: calm, hardly a gesture; 0.5: in conversation; 1: a storyteller.", 1)
            about = "Change how lively the avatar gestures from now on."
            plain.insert(1, _tool("set_manner", about, {"liveliness": liveliness}))
        return render(style, plain)


def _number(description: str, most: float) -> Schema:
    return {"type": "number", "minimum": 0, "maximum": most, "description": description}


def _tool(name: str, description: str, properties: Schema, required: Sequence[str] = ()) -> Schema:
    parameters = {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}
    return {"name": name, "description": description, "parameters": parameters}


def checked(tools: Sequence[Schema], name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a model's call, checked against the plain declarations; null counts as left out.

    Raises:
        EchoAvatarError: there is no such tool, or an argument is unknown, missing, of another type or out of bounds.
    """
    parameters = {tool["name"]: tool["parameters"] for tool in tools}
    if name not in parameters:
        raise EchoAvatarError(f"no tool {name!r}; there are: {', '.join(parameters)}")
    known, given = parameters[name]["properties"], {k: v for k, v in arguments.items() if v is not None}
    wrong = [key for key in given if key not in known]
    if wrong:
        raise EchoAvatarError(f"{name} knows no {wrong[0]!r}; it takes: {', '.join(known) or 'nothing'}")
    lacking = [key for key in parameters[name]["required"] if key not in given]
    if lacking:
        raise EchoAvatarError(f"{name} needs {lacking[0]!r}")
    for key, value in given.items():
        if known[key]["type"] == "number":
            least, most = known[key]["minimum"], known[key]["maximum"]
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            wanted = "" if is_number and least <= value <= most else f"a number from {least:g} to {most:g}"
        else:
            wanted = "" if isinstance(value, str) else "a string"
        if wanted:
            raise EchoAvatarError(f"{name}: {key} is {repr(value)[:20]}; it must be {wanted}")
    return given


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


def _renamed(key: str) -> Callable[[Schema], Schema]:
    return lambda tool: {"name": tool["name"], "description": tool["description"], key: tool["parameters"]}


_FORMS: Mapping[str, Callable[[Schema], Schema]] = {
    "plain": dict,
    "openai": lambda tool: {"type": "function", **tool},
    "openai-chat": lambda tool: {"type": "function", "function": dict(tool)},
    "anthropic": _renamed("input_schema"),
    "mcp": _renamed("inputSchema"),
    "elevenlabs": _elevenlabs,
    "pipecat": lambda tool: {
        key: tool.get(key, tool["parameters"].get(key)) for key in ("name", "description", "properties", "required")
    },
    "livekit": dict,
}
