"""Offer the avatar's tools to the model, and carry out its calls.

Only calls of the avatar's tools are answered. If the client has a tool of the same name, the client's tool is the one
that counts. No `response.create` follows a gesture, unless the response held nothing but calls: then the model would
not speak at all.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object

from .events import Event, inside, tools_of

TOOLS_WITH_ANSWERS = ("list_actions",)  # tools whose result the model must act on
MAX_FOLLOW_UPS = 2  # how often the model is asked to continue before the user speaks again

Send = Callable[[dict[str, Any]], Awaitable[None]]
Do = Callable[[str, dict[str, Any]], Awaitable[dict[str, Any]]]


class ToolCalls:
    """The tool calls of one Realtime session."""

    def __init__(self, send: Send, do: Do) -> None:
        self.declared: list[dict[str, Any]] = []  # the avatar's tools in the Realtime form; empty: none are offered
        self._send, self._do = send, do
        self._client_tools: list[Any] = []  # declared by the client
        self._session_type: Any = None  # the session's `type`
        self._is_begun = self._is_offered = False
        self._answered: set[str] = set()  # ids of calls
        self._calls: dict[str | None, list[tuple[str, asyncio.Task[None]]]] = {}  # by response id
        self._following_up: set[asyncio.Task[None]] = set()
        self._follow_ups = 0

    def on_session(self, session: Any, *, is_first: bool = False) -> None:
        """Note which tools the client has: from the server's first event (`is_first`) or from a client's update."""
        tools = tools_of(session)
        if is_first:
            self._session_type, self._is_begun = inside(session, "type") or self._session_type, True
        if tools is not None:
            self._client_tools = tools

    async def offer(self) -> None:
        """Add the avatar's tools to the session, once."""
        if self._is_offered or not self._is_begun or not self.declared:
            return
        self._is_offered = True
        session: dict[str, Any] = {"tools": self.with_ours(self._client_tools)}
        if self._session_type is not None:  # required by the present protocol, unknown to its first version
            session["type"] = self._session_type
        await self._send({"type": "session.update", "event_id": "echoavatar_tools", "session": session})

    def with_ours(self, own: list[Any]) -> list[Any]:
        """The client's tools and the avatar's; where names collide, the client's."""
        names = _names(own)
        return own + [tool for tool in self.declared if tool["name"] not in names]

    def on_model_event(self, event: Event) -> None:
        """Handle an event of the model and start the calls in it."""
        if event.type == "response.output_item.done" and inside(event.item, "type") == "function_call":
            self._begin(
                _text(event.item, "call_id"),
                _text(event.item, "name"),
                inside(event.item, "arguments"),
                event.response_id,
            )
        elif event.type == "response.function_call_arguments.done" and event.name:
            self._begin(event.call_id, event.name, event.arguments, event.response_id)
        elif event.type == "response.done" and _text(event.response, "id") in self._calls:
            task = asyncio.create_task(self._follow_up(event.response))
            self._following_up.add(task)
            task.add_done_callback(self._following_up.discard)

    def on_user_turn(self) -> None:
        """The user took a turn."""
        self._follow_ups = 0

    def _begin(self, call: str | None, name: str | None, arguments: Any, response: str | None) -> None:
        avatar_names = {tool["name"] for tool in self.declared} - _names(self._client_tools)
        if call is None or name is None or name not in avatar_names or call in self._answered:
            return
        self._answered.add(call)
        task = asyncio.create_task(self._answer(call, name, arguments))
        self._calls.setdefault(response, []).append((name, task))

    async def _answer(self, call: str, name: str, arguments: Any) -> None:
        try:
            is_object = isinstance(arguments, dict)  # servers other than OpenAI's may send an object, not its text
            answer = await self._do(name, arguments if is_object else read_object(arguments or "{}", "the arguments"))
        except EchoAvatarError as error:
            answer = {"status": "rejected", "reason": str(error)}
        item = {"type": "function_call_output", "call_id": call, "output": json.dumps(answer)}
        await self._send({"type": "conversation.item.create", "item": item})

    async def _follow_up(self, response: Any) -> None:
        """A response is complete: ask the model to continue if it made calls only, or needs a result."""
        calls = self._calls.pop(_text(response, "id"), [])
        await asyncio.gather(*(task for _, task in calls), return_exceptions=True)
        items = inside(response, "output")
        kinds = [inside(item, "type") for item in items] if isinstance(items, list) else []
        is_silent = "message" not in kinds and kinds.count("function_call") <= len(calls)
        if inside(response, "status") in ("cancelled", "failed") or self._follow_ups >= MAX_FOLLOW_UPS:
            return
        if is_silent or any(name in TOOLS_WITH_ANSWERS for name, _ in calls):
            self._follow_ups += 1
            await self._send({"type": "response.create"})

    def cancel(self) -> None:
        """Cancel everything: the conversation is over."""
        for task in (*self._following_up, *(task for calls in self._calls.values() for _, task in calls)):
            task.cancel()


def _names(tools: list[Any]) -> set[str]:
    return {name for tool in tools if (name := _text(tool, "name")) is not None}


def _text(value: Any, key: str) -> str | None:
    """A text in an object; None if it is absent or of another type, such as a list, which is not hashable."""
    found = inside(value, key)
    return found if isinstance(found, str) else None
