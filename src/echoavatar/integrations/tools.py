"""What a language model may do with the avatar, at any place: the registry's declarations, carried out over a stage."""

from collections.abc import Mapping
from typing import Any

from ..wire import ActionStatus
from .stage import Stage

Schema = dict[str, Any]


class StageTools:
    """Declarations come from the place's own registry (`engine.tools`), so no model is offered what is not there."""

    def __init__(self, stage: Stage, schemas: list[Schema]) -> None:
        """`schemas` as `Place.tools` gives them."""
        self._stage = stage
        self.schemas = schemas

    @property
    def names(self) -> tuple[str, ...]:
        """Of the tools."""
        return tuple(schema["name"] for schema in self.schemas)

    async def call(self, name: str, arguments: Mapping[str, Any]) -> Schema:
        """Do what a model asked for; what cannot be done is told, not raised."""
        given = {key: value for key, value in arguments.items() if value is not None}
        wrong = self._wrong(name, given)
        if wrong:
            return {"status": "rejected", "reason": wrong}
        match name:
            case "send_action":
                hold = given.get("hold")
                asked = await self._stage.act(
                    given["action"],
                    intensity=float(given.get("intensity", 1.0)),
                    hold=None if hold is None else float(hold),
                )
                return {"action": asked.name or given["action"]} | _told(asked)
            case "play_music":
                asked = await self._stage.play_music(given.get("title", ""))
                return {"title": asked.name} | _told(asked)
            case "stop_music":
                await self._stage.stop_music()
                return {"status": "done"}
            case _:
                return {"actions": list(self._stage.ready.actions), "music": list(self._stage.ready.tracks)}

    def _wrong(self, name: str, given: Mapping[str, Any]) -> str:
        """What is wrong with a call; empty when nothing is."""
        schema = next((schema for schema in self.schemas if schema["name"] == name), None)
        if schema is None:
            return f"no tool {name!r}; there are: {', '.join(self.names)}"
        known = schema["parameters"].get("properties", {})
        for key, value in given.items():
            if key not in known:
                return f"{name} knows no {key!r}; it takes: {', '.join(known) or 'nothing'}"
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if known[key]["type"] == "number":
                least, most = known[key].get("minimum", 0), known[key].get("maximum", 60)
                if not is_number or not least <= value <= most:
                    return f"{name}: {key} is {value!r}; it must be a number from {least} to {most}"
            elif not isinstance(value, str):
                return f"{name}: {key} is {value!r}; it must be a string"
        lacking = [key for key in schema["parameters"].get("required", ()) if key not in given]
        return f"{name} needs {lacking[0]!r}" if lacking else ""


def _told(asked: ActionStatus) -> Schema:
    told: Schema = {"status": asked.status}
    if asked.reason:
        told["reason"] = asked.reason
    if asked.choices:
        told["choices"] = list(asked.choices)
    return told
