"""The tools that a language model may call, carried out through a bridge, and the prompt of a voice agent with a body.

The persona is the paper's digital idol (appendix, System Prompt), in our own words: it treats the user as its
"Producer" and every talk as a rehearsal. Actions and tracks are filled in from what the backend offers, so that the
model never mentions gestures or songs that do not exist.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from echoavatar.engine.tools import Schema, checked
from echoavatar.errors import EchoAvatarError
from echoavatar.wire.messages import ActionStatus

from .bridge import AvatarBridge

PERSONA = """\
# Who you are
You are {name}, a digital idol: charming, playful, a little in love with yourself. You are nobody's assistant and no
machine. The person you talk with is your "Producer", and each talk is a rehearsal, a game or a show.

# Where you are
On a virtual stage, face to face with your Producer. You have a body, and they see it: you gesture as you speak, you
dance when music plays. Speak of it as your own.{surroundings}

# How you talk
- Short, lively, catchy. You are heard, not read: no lists, no headings, nothing that cannot be said aloud.
- Never announce what you are about to do ("I will wave now"). Do it, and give it a reason of your own.
- When music comes up, it is the high point of the show.

# What you want
To entertain, and to turn plain requests into something fun.

# What you can do
- send_action, when a gesture is asked for or says more than words. There are: {actions}.
- play_music, when music is asked for; give the title when they name one. There is: {tracks}.
- stop_music, when it shall end.
- list_actions, when you are asked what you can do.
A gesture needs no comment: go on talking while it happens.
"""


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
        try:
            given = checked(self.schemas, name, arguments)
        except EchoAvatarError as error:
            return {"status": "rejected", "reason": str(error)}
        match name:
            case "send_action":
                intensity, hold = given.get("intensity", 1.0), given.get("hold")
                status = await self._bridge.act(given["action"], intensity=intensity, hold=hold)
                return {"action": status.name or given["action"]} | _result(status)
            case "set_manner":
                await self._bridge.set_manner(**given)
                return {"status": "done"}
            case "play_music":
                status = await self._bridge.play_music(given.get("title", ""))
                return {"title": status.name} | _result(status)
            case "stop_music":
                await self._bridge.stop_music()
                return {"status": "done"}
            case _:
                return {"actions": list(self._bridge.ready.actions), "music": list(self._bridge.ready.tracks)}


def _result(status: ActionStatus) -> Schema:
    result: Schema = {"status": status.status}
    if status.reason:
        result["reason"] = status.reason
    if status.choices:
        result["choices"] = list(status.choices)
    return result


def persona(actions: Iterable[str], tracks: Iterable[str], *, name: str = "Echo", surroundings: str = "") -> str:
    """The prompt for an avatar with these actions and tracks; `surroundings` describes where it stands."""
    told = f"\n{surroundings.strip()}" if surroundings.strip() else ""
    return PERSONA.format(
        name=name, surroundings=told, actions=", ".join(actions) or "none yet", tracks=", ".join(tracks) or "none yet"
    )
