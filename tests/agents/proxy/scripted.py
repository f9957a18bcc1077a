"""A scripted voice agent: a Realtime upstream without a model.

It sends what a script tells it to, in the events that OpenAI documents, and acknowledges every session update and every
item that the client adds.
"""

import asyncio
import base64
import itertools
import json
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from echoavatar.agents.client.connection import quiet_logger
from echoavatar.timing import SAMPLE_RATE_HZ

Script = Callable[["ScriptedSession"], Awaitable[None]]
DELTA_S = 0.1


class ScriptedSession:
    """One connection's conversation, from the agent's side."""

    def __init__(self, websocket: ServerConnection) -> None:
        self.websocket = websocket
        self.received: list[dict[str, Any]] = []  # events of the client
        self.sent: list[str] = []
        self.session: dict[str, Any] = {
            "type": "realtime",
            "object": "realtime.session",
            "id": "sess_1",
            "model": "scripted",
            "audio": {
                "input": {
                    "format": {"type": "audio/pcm", "rate": SAMPLE_RATE_HZ},
                    "turn_detection": {"type": "server_vad", "interrupt_response": True},
                },
                "output": {"format": {"type": "audio/pcm", "rate": SAMPLE_RATE_HZ}, "voice": "scripted"},
            },
            "tools": [],
        }
        self._numbers = itertools.count(1)
        self._new_event = asyncio.Event()

    async def send(self, kind: str, **fields: Any) -> None:
        """Send one event."""
        event = {"type": kind, "event_id": f"event_{next(self._numbers)}", **fields}
        await self.send_text(json.dumps(event))

    async def send_text(self, text: str) -> None:
        """Send any text."""
        self.sent.append(text)
        await self.websocket.send(text)

    async def until(self, kind: str, count: int = 1) -> dict[str, Any]:
        """Wait until the client has sent `count` events of this type; returns the last of them."""
        while True:
            found = [event for event in self.received if event.get("type") == kind]
            if len(found) >= count:
                return found[count - 1]
            self._new_event.clear()
            await self._new_event.wait()

    async def say(
        self,
        pcm: bytes,
        *,
        item: str = "item_1",
        response: str = "resp_1",
        delta_s: float = DELTA_S,
        pace: float = 0.0,
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        """Speak a response, waiting `pace` seconds per second of sound; stops early when `until` returns true."""
        address = {"response_id": response, "item_id": item, "output_index": 0, "content_index": 0}
        await self.send("response.created", response={"id": response, "status": "in_progress", "output": []})
        size = 2 * round(delta_s * SAMPLE_RATE_HZ)
        status = "completed"
        for start in range(0, len(pcm), size):
            if until():
                status = "cancelled"
                break
            delta = base64.b64encode(pcm[start : start + size]).decode()
            await self.send("response.output_audio.delta", **address, delta=delta)
            await asyncio.sleep(pace * delta_s)
        await self.send("response.output_audio.done", **address)
        message = {"id": item, "type": "message", "role": "assistant", "content": []}
        done = {"id": response, "status": status, "output": [message]}
        await self.send("response.done", response=done)

    async def call(self, name: str, arguments: str, *, call: str = "call_1", response: str = "resp_1") -> None:
        """Send a response that consists of one function call."""
        item = {"id": f"item_{call}", "type": "function_call", "name": name, "call_id": call}
        whole = {**item, "arguments": arguments, "status": "completed"}
        address = {"response_id": response, "output_index": 0}
        await self.send("response.created", response={"id": response, "status": "in_progress", "output": []})
        await self.send("response.output_item.added", **address, item={**item, "arguments": ""})
        await self.send(
            "response.function_call_arguments.done",
            **address,
            item_id=item["id"],
            call_id=call,
            name=name,
            arguments=arguments,
        )
        await self.send("response.output_item.done", **address, item=whole)
        await self.send("response.done", response={"id": response, "status": "completed", "output": [whole]})

    async def _listen(self) -> None:
        async for message in self.websocket:
            try:
                event = json.loads(message)
            except (ValueError, RecursionError):
                continue
            if not isinstance(event, dict):
                continue
            self.received.append(event)
            self._new_event.set()
            if event.get("type") == "session.update":
                self.session |= event["session"]
                await self.send("session.updated", session=self.session)
            elif event.get("type") == "conversation.item.create":
                await self.send("conversation.item.added", item=event["item"])


class ScriptedUpstream:
    """Listens at `url`; the script plays the agent's side of every connection."""

    def __init__(self, script: Script, *, port: int = 0, subprotocols: tuple[str, ...] = ()) -> None:
        self.sessions: list[ScriptedSession] = []
        self.requests: list[tuple[str, dict[str, str]]] = []  # path and headers of each request
        self.url = ""
        self._script, self._port, self._subprotocols = script, port, subprotocols
        self._server: Server | None = None

    async def __aenter__(self) -> "ScriptedUpstream":
        """Start to listen."""
        self._server = await serve(
            self._play,
            "127.0.0.1",
            self._port,
            compression=None,
            subprotocols=list(self._subprotocols) or None,  # type: ignore[arg-type]
            max_size=None,
            logger=quiet_logger(),
        )
        port = next(iter(self._server.sockets)).getsockname()[1]
        self.url = f"ws://127.0.0.1:{port}/v1/realtime"
        return self

    async def __aexit__(self, *reason: object) -> None:
        """Close all connections."""
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()

    async def _play(self, websocket: ServerConnection) -> None:
        assert websocket.request is not None
        self.requests.append((websocket.request.path, dict(websocket.request.headers.raw_items())))
        session = ScriptedSession(websocket)
        self.sessions.append(session)
        listening = asyncio.create_task(session._listen())
        try:
            await session.send("session.created", session=session.session)
            await self._script(session)
            await listening
        except ConnectionClosed:
            pass  # either side closed the connection
        finally:
            listening.cancel()
