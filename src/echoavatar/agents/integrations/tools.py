"""The tools that a language model may call on the session of a bridge, and the prompt of a voice agent with a body.

The persona is the paper's digital idol (appendix, System Prompt), in our own words: it treats the user as its
"Producer" and every talk as a rehearsal. Actions and tracks are filled in from what the backend offers, so that the
model never mentions gestures or songs that do not exist.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from echoavatar.engine.tools import Schema

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
        return await self._bridge.backend.call(name, arguments, self._bridge.ready.session)


def persona(actions: Iterable[str], tracks: Iterable[str], *, name: str = "Echo", surroundings: str = "") -> str:
    """The prompt for an avatar with these actions and tracks; `surroundings` describes where it stands."""
    told = f"\n{surroundings.strip()}" if surroundings.strip() else ""
    return PERSONA.format(
        name=name, surroundings=told, actions=", ".join(actions) or "none yet", tracks=", ".join(tracks) or "none yet"
    )
