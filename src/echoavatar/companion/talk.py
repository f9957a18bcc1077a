"""What a companion is, and which one this machine has."""

import os
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ..errors import EchoAvatarError

Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]
MOST_REMEMBERED = 24  # sayings of both sides


class Said(NamedTuple):
    """Something that was said before."""

    role: str  # user or assistant
    text: str


class Doing(NamedTuple):
    """The avatar's tools: their declarations for Chat Completions, and how to do one."""

    tools: Sequence[Mapping[str, Any]]
    do: Do


class Companion(Protocol):
    """Somebody to talk to."""

    name: str
    hears: bool  # whether spoken words can be made into text

    async def reply(self, said: str, history: Sequence[Said], doing: Doing) -> str:
        """What to say, after what is to be done was begun.

        Raises:
            EchoAvatarError: nobody answers.
        """
        ...

    async def transcribe(self, wav: bytes) -> str:
        """The words of a sound; empty where nothing was understood.

        Raises:
            EchoAvatarError: this one has no ears, or they do not answer.
        """
        ...


def from_environment(environment: Mapping[str, str] = os.environ) -> Companion:
    """A model where `ECHOAVATAR_CHAT_URL` names an endpoint, else the script.

    `ECHOAVATAR_CHAT_MODEL`, `ECHOAVATAR_CHAT_KEY`, `ECHOAVATAR_CHAT_EARS` (a model that transcribes) and
    `ECHOAVATAR_PERSONA` (a text file) say more.

    Raises:
        EchoAvatarError: the address or the file cannot be.
    """
    from .model import ChatModel
    from .persona import PERSONA
    from .script import Scripted

    url = environment.get("ECHOAVATAR_CHAT_URL", "")
    if not url:
        return Scripted()
    path = environment.get("ECHOAVATAR_PERSONA", "")
    try:
        persona = Path(path).read_text("utf-8") if path else PERSONA
    except (OSError, UnicodeError) as error:
        raise EchoAvatarError(f"ECHOAVATAR_PERSONA: cannot read {path}; give a text file") from error
    return ChatModel(
        url,
        model=environment.get("ECHOAVATAR_CHAT_MODEL", ""),
        key=environment.get("ECHOAVATAR_CHAT_KEY", ""),
        ears=environment.get("ECHOAVATAR_CHAT_EARS", ""),
        persona=persona,
    )
