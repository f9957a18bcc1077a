"""The avatar's tools, offered to the model and done when it calls them.

Only the model's calls of our names are answered; a tool of the same name that the client brought is the client's. A
gesture is silent: no `response.create` follows it, unless the model did nothing but call, for then nobody would speak.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

from .events import Event, inside, tools_of

TELLING = ("list_actions",)  # tools whose answer the model has to hear
MOST_TURNS = 2  # that the model is asked to go on, without a word of the user's in between

Send = Callable[[dict[str, Any]], Awaitable[None]]
Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]


class Calls:
    """Tools of one Realtime session."""

    def __init__(self, send: Send, do: Do) -> None:
        self.declared: list[dict[str, Any]] = []  # ours, in the Realtime form; empty: not offered
        self._send, self._do = send, do
        self._own: list[Any] = []  # the client's
        self._theirs: set[str] = set()  # their names
        self._type: Any = None  # of the session
        self._is_begun = self._is_offered = False
        self._answered: set[str] = set()  # call ids
        self._running: dict[str | None, list[asyncio.Task[None]]] = {}  # by response
        self._called: dict[str | None, list[str]] = {}
        self._going_on: set[asyncio.Task[None]] = set()
        self._turns = 0

    def session_tells(self, session: Any, *, is_first: bool = False) -> None:
        """`session.created` (`is_first`), or a client's update: which tools are the client's own."""
        tools = tools_of(session)
        if is_first and isinstance(session, dict):
            self._type, self._is_begun = session.get("type"), True
        if tools is not None:
            self._own = tools
        self._theirs = _names(self._own)

    async def offer(self) -> None:
        """Add ours to what the session has, once."""
        if self._is_offered or not self._is_begun or not self.declared:
            return
        self._is_offered = True
        session: dict[str, Any] = {"tools": self.with_ours(self._own)}
        if self._type is not None:  # the present protocol wants it, the first one did not know it
            session["type"] = self._type
        await self._send({"type": "session.update", "event_id": "echoavatar_tools", "session": session})

    def with_ours(self, own: list[Any]) -> list[Any]:
        """A list of tools and ours; where names are the same, theirs."""
        names = _names(own)
        return own + [tool for tool in self.declared if tool["name"] not in names]

    def notice(self, event: Event) -> None:
        """An event of the model's; begins what it calls."""
        if event.type == "response.output_item.done" and inside(event.item, "type") == "function_call":
            self._begin(
                inside(event.item, "call_id"),
                inside(event.item, "name"),
                inside(event.item, "arguments"),
                event.response_id,
            )
        elif event.type == "response.function_call_arguments.done" and event.name:
            self._begin(event.call_id, event.name, event.arguments, event.response_id)
        elif event.type == "response.done" and inside(event.response, "id") in self._running:
            task = asyncio.create_task(self._go_on(event.response))
            self._going_on.add(task)
            task.add_done_callback(self._going_on.discard)

    def user_spoke(self) -> None:
        """A turn of the user's."""
        self._turns = 0

    def _begin(self, call: Any, name: Any, arguments: Any, response: str | None) -> None:
        ours = {tool["name"] for tool in self.declared} - self._theirs
        if not isinstance(call, str) or name not in ours or call in self._answered:
            return
        self._answered.add(call)
        self._called.setdefault(response, []).append(name)
        task = asyncio.create_task(self._answer(call, name, arguments))
        self._running.setdefault(response, []).append(task)

    async def _answer(self, call: str, name: str, arguments: Any) -> None:
        try:
            given = json.loads(arguments) if arguments else {}
        except (ValueError, TypeError, RecursionError):
            given = None
        if isinstance(given, dict):
            answer = await self._do(name, given)
        else:
            answer = {"status": "rejected", "reason": "the arguments are no JSON object"}
        item = {"type": "function_call_output", "call_id": call, "output": json.dumps(answer)}
        await self._send({"type": "conversation.item.create", "item": item})

    async def _go_on(self, response: Any) -> None:
        """A response is complete: where it was nothing but calls of ours, the model is asked to go on."""
        key = inside(response, "id")
        tasks, names = self._running.pop(key, []), self._called.pop(key, [])
        await asyncio.gather(*tasks, return_exceptions=True)
        items = inside(response, "output")
        kinds = [inside(item, "type") for item in items] if isinstance(items, list) else []
        is_mute = "message" not in kinds and kinds.count("function_call") <= len(names)
        if inside(response, "status") in ("cancelled", "failed") or self._turns >= MOST_TURNS:
            return
        if is_mute or any(name in TELLING for name in names):
            self._turns += 1
            await self._send({"type": "response.create"})

    def cancel(self) -> None:
        """The conversation is over."""
        for task in (*self._going_on, *(task for tasks in self._running.values() for task in tasks)):
            task.cancel()


def _names(tools: list[Any]) -> set[str]:
    return {name for tool in tools if isinstance(name := inside(tool, "name"), str)}
