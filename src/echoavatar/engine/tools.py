"""What a language model may do with the avatar: typed functions and their schemas, the same for every framework.

The schemas' enums come from the live libraries, so a model is only offered gestures and tracks that exist. A tool that
is asked for another one answers "rejected" with the list; it never raises. All tools are silent: the model need not say
anything about the result.

`render` makes the declarations in the form that each framework takes. Fields that a framework does not know are left
out (`additionalProperties` for Gemini, bounds for ElevenLabs); only fields that it requires are added. A gesture needs
no comment by the model, so ElevenLabs is told to expect a response from the tools in `TELLING` only.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from echoavatar.engine.pipeline.actions import LONGEST_S, ActionLibrary
from echoavatar.errors import EchoAvatarError

from .action_scheduler import STRONGEST, ActStatus
from .music import Tracks

__all__ = ["HIDDEN", "Actor", "Schema", "Style", "Tool", "Toolbox"]
TrackLoader = Callable[[str], Awaitable[Float[np.ndarray, " s"]]]
HIDDEN = ("listen", "nod")  # actions that the avatar does by itself
Schema = dict[str, Any]
Style = Literal["plain", "openai", "openai-chat", "anthropic", "gemini", "mcp", "elevenlabs", "pipecat", "livekit"]
TELLING = ("list_actions",)  # tools whose answer the model needs


class Actor(Protocol):
    """The session that the tools act on: an engine's, or a server's."""

    def act(self, name: str, *, intensity: float = 1.0, hold_s: float | None = None) -> ActStatus:
        """Begin an action."""
        ...

    def play(self, title: str, track: Float[np.ndarray, " s"]) -> None:
        """Play a track, 24 kHz mono."""
        ...

    def stop_music(self) -> None:
        """Fade the music out."""
        ...


class Tool(NamedTuple):
    """A function on a session, with its name, its purpose and the JSON Schema of its arguments."""

    name: str
    description: str
    parameters: Schema
    function: Callable[..., Schema]


class Toolbox:
    """The tools over one action library and one music library."""

    def __init__(self, actions: ActionLibrary, tracks: Tracks) -> None:
        self._actions, self._tracks = actions, tracks

    @property
    def tools(self) -> tuple[Tool, ...]:
        """All tools, with the enums of the libraries as they are now."""
        names = [name for name in self._actions if name not in HIDDEN]
        meanings = "; ".join(f"{name}: {self._actions[name].about}" for name in names)
        action = {"type": "string", "enum": names, "description": f"What to do. {meanings}"}
        intensity = _number("How strongly; 1 is normal.", STRONGEST)
        hold = _number("Seconds to hold it; left out, it takes its natural time.", LONGEST_S)
        title: Schema = {"type": "string", "description": "Left out, the first one plays."}
        if self._tracks.titles:
            title["enum"] = list(self._tracks.titles)
        return (
            Tool(
                "send_action",
                "Let the avatar do a gesture now, while it speaks or in silence. It ends by itself.",
                _object({"action": action, "intensity": intensity, "hold": hold}, ["action"]),
                self.send_action,
            ),
            Tool(
                "play_music",
                "Play music; the avatar hears it and dances. It goes on until its end or stop_music.",
                _object({"title": title}, []),
                self.play_music,
            ),
            Tool("stop_music", "Fade the music out.", _object({}, []), self.stop_music),
            Tool("list_actions", "Name the gestures the avatar can do.", _object({}, []), self.list_actions),
        )

    def send_action(self, session: Actor, action: str, intensity: float = 1.0, hold: float | None = None) -> Schema:
        """Begin an action."""
        asked = session.act(action, intensity=intensity, hold_s=hold)
        return {"status": asked.status, "id": asked.id, "action": asked.name} | (
            {"reason": asked.reason} if asked.reason else {}
        )

    def play_music(self, session: Actor, title: str | None = None) -> Schema:
        """Begin a track, the first one without a title."""
        found = self.find_track(title)
        session.play(found, self._tracks.load(found))
        return {"status": "accepted", "title": found}

    def find_track(self, title: str | None) -> str:
        """The exact title that `play_music` plays.

        Raises:
            EchoAvatarError: there is no such track, or no music at all.
        """
        if title is None and not self._tracks.titles:
            raise EchoAvatarError("there is no music")
        return self._tracks.find(title or self._tracks.titles[0])

    def stop_music(self, session: Actor) -> Schema:
        """Fade the music out."""
        session.stop_music()
        return {"status": "done"}

    def list_actions(self, session: Actor) -> Schema:
        """List names and meanings."""
        del session
        return {"actions": {n: a.about for n, a in self._actions.items() if n not in HIDDEN}}

    def call(self, session: Actor, name: str, arguments: Mapping[str, Any]) -> Schema:
        """Run the tool a model asked for; failure is an answer, not an exception.

        `play_music` decodes its track, which may take a while; an event loop awaits `call_async`.
        """
        try:
            tool, checked = self._checked(name, arguments)
            return tool.function(session, **checked)
        except EchoAvatarError as error:
            return {"status": "rejected", "reason": str(error)}

    async def call_async(self, session: Actor, name: str, arguments: Mapping[str, Any], load: TrackLoader) -> Schema:
        """As `call`, on the session's event loop; `load` decodes a track elsewhere."""
        try:
            tool, checked = self._checked(name, arguments)
            if name != "play_music":
                return tool.function(session, **checked)
            found = self.find_track(checked.get("title"))
            session.play(found, await load(found))
            return {"status": "accepted", "title": found}
        except EchoAvatarError as error:
            return {"status": "rejected", "reason": str(error)}

    def _checked(self, name: str, arguments: Mapping[str, Any]) -> tuple[Tool, dict[str, Any]]:
        """A tool by its name, and its arguments, checked against the schema."""
        tools = {tool.name: tool for tool in self.tools}
        if name not in tools:
            raise EchoAvatarError(f"no tool {name!r}; there are: {', '.join(tools)}")
        return tools[name], _checked(tools[name], arguments)

    def schemas(self, style: Style = "plain") -> list[Schema]:
        """Declarations in a framework's form; see `render`."""
        keys = ("name", "description", "parameters")
        return render(style, [{key: getattr(tool, key) for key in keys} for tool in self.tools])


def _number(description: str, most: float) -> Schema:
    return {"type": "number", "minimum": 0, "maximum": most, "description": description}


def _object(properties: Schema, required: list[str]) -> Schema:
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _checked(tool: Tool, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments, checked against the types and bounds of the schema; null counts as left out."""
    known, given = tool.parameters["properties"], {k: v for k, v in arguments.items() if v is not None}
    wrong = [name for name in given if name not in known]
    if wrong:
        raise EchoAvatarError(f"{tool.name} knows no {wrong[0]!r}; it takes: {', '.join(known) or 'nothing'}")
    lacking = [name for name in tool.parameters["required"] if name not in given]
    if lacking:
        raise EchoAvatarError(f"{tool.name} needs {lacking[0]!r}")
    for name, value in given.items():
        kinds = (int, float) if known[name]["type"] == "number" else (str,)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        is_huge = is_number and not abs(value) <= 1e9  # not a number, infinite, or an integer that no float holds
        if not isinstance(value, kinds) or isinstance(value, bool) or is_huge:
            raise EchoAvatarError(f"{tool.name}: {name} is {repr(value)[:20]}; it must be a {known[name]['type']}")
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
