"""What a companion is, and which one this machine has."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

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

    def choices(self, name: str, argument: str) -> list[str]:
        """The values that an argument of a tool may take; none where the tool does not list them."""
        for tool in self.tools:
            function = tool["function"]
            if function["name"] == name:
                return list(function["parameters"]["properties"][argument].get("enum", ()))
        return []


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
