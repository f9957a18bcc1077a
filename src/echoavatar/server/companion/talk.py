"""What a companion is, and what it is given: earlier turns of the conversation and the avatar's tools."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]
MAX_HISTORY_TURNS = 24  # turns, of both sides together


class ChatTurn(NamedTuple):
    """A turn of the conversation."""

    role: str  # user or assistant
    text: str


class ToolAccess(NamedTuple):
    """The avatar's tools: their declarations for Chat Completions, and a function that carries out a call."""

    tools: Sequence[Mapping[str, Any]]
    do: Do

    def choices(self, name: str, argument: str) -> list[str]:
        """The values that an argument of a tool may take; empty if the tool does not list any."""
        for tool in self.tools:
            function = tool["function"]
            if function["name"] == name:
                return list(function["parameters"]["properties"][argument].get("enum", ()))
        return []


class Companion(Protocol):
    """Answers what the user says."""

    name: str
    hears: bool  # whether `transcribe` works

    async def reply(self, said: str, history: Sequence[ChatTurn], doing: ToolAccess) -> str:
        """The answer to say; actions that go with it have been started.

        Raises:
            EchoAvatarError: the model does not answer.
        """
        ...

    async def transcribe(self, wav: bytes) -> str:
        """Transcribe a WAV file; empty if nothing was understood.

        Raises:
            EchoAvatarError: this companion cannot transcribe, or its model does not answer.
        """
        ...
