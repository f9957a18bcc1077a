"""The tools that a language model may call, carried out through a bridge."""

from collections.abc import Mapping
from typing import Any

from echoavatar.wire import ActionStatus

from .bridge import AvatarBridge

Schema = dict[str, Any]


class AvatarTools:
    """The avatar's tools. The backend declares them (`engine.tools`), so no model is offered what does not exist."""

    def __init__(self, bridge: AvatarBridge, schemas: list[Schema]) -> None:
        """`schemas` come from `AvatarBackend.tools`."""
        self._bridge = bridge
        self.schemas = schemas

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the tools."""
        return tuple(schema["name"] for schema in self.schemas)

    async def call(self, name: str, arguments: Mapping[str, Any]) -> Schema:
        """Carry out a model's call. A call that fails returns the status `rejected`; nothing is raised."""
        given = {key: value for key, value in arguments.items() if value is not None}
        wrong = self._find_error(name, given)
        if wrong:
            return {"status": "rejected", "reason": wrong}
        match name:
            case "send_action":
                hold = given.get("hold")
                status = await self._bridge.act(
                    given["action"],
                    intensity=float(given.get("intensity", 1.0)),
                    hold=None if hold is None else float(hold),
                )
                return {"action": status.name or given["action"]} | _result(status)
            case "play_music":
                status = await self._bridge.play_music(given.get("title", ""))
                return {"title": status.name} | _result(status)
            case "stop_music":
                await self._bridge.stop_music()
                return {"status": "done"}
            case _:
                return {"actions": list(self._bridge.ready.actions), "music": list(self._bridge.ready.tracks)}

    def _find_error(self, name: str, given: Mapping[str, Any]) -> str:
        """What is wrong with a call; empty if nothing is."""
        schema = next((schema for schema in self.schemas if schema["name"] == name), None)
        if schema is None:
            return f"no tool {name!r}; there are: {', '.join(self.names)}"
        known = schema["parameters"].get("properties", {})
        for key, value in given.items():
            if key not in known:
                return f"{name} has no argument {key!r}; it takes: {', '.join(known) or 'nothing'}"
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if known[key]["type"] == "number":
                least, most = known[key].get("minimum", 0), known[key].get("maximum", 60)
                if not is_number or not least <= value <= most:
                    return f"{name}: {key} is {value!r}; it must be a number from {least} to {most}"
            elif not isinstance(value, str):
                return f"{name}: {key} is {value!r}; it must be a string"
        missing = [key for key in schema["parameters"].get("required", ()) if key not in given]
        return f"{name} needs {missing[0]!r}" if missing else ""


def _result(status: ActionStatus) -> Schema:
    result: Schema = {"status": status.status}
    if status.reason:
        result["reason"] = status.reason
    if status.choices:
        result["choices"] = list(status.choices)
    return result
