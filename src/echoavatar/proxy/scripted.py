"""A voice agent that plays a part: a Realtime upstream without a model, for tests, benches and trying things offline.

It says what it is told to say, in the events that OpenAI documents, as fast as it is told to; it hears the user by a
`input_audio_buffer.commit`, and every item that a client adds it acknowledges. Nothing of it is a model's.
"""

import asyncio
import base64
import itertools
import json
from collections.abc import Awaitable, Callable
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from ..timing import SAMPLE_RATE_HZ
from .upstream import quiet_logger

Script = Callable[["Part"], Awaitable[None]]
DELTA_S = 0.1


class Part:
    """One connection's conversation, from the agent's side."""

    def __init__(self, line: ServerConnection) -> None:
        self.line = line
        self.got: list[dict[str, Any]] = []  # the client's events
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
        self._news = asyncio.Event()

    async def send(self, kind: str, **fields: Any) -> None:
        """One event."""
        event = {"type": kind, "event_id": f"event_{next(self._numbers)}", **fields}
        await self.send_text(json.dumps(event))

    async def send_text(self, text: str) -> None:
        """Anything."""
        self.sent.append(text)
        await self.line.send(text)

    async def until(self, kind: str, count: int = 1) -> dict[str, Any]:
        """Wait for the client's event; returns the last of `count`."""
        while True:
            found = [event for event in self.got if event.get("type") == kind]
            if len(found) >= count:
                return found[count - 1]
            self._news.clear()
            await self._news.wait()

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
        """A spoken response: `pace` seconds are waited for each second of sound; ends early where `until` says so."""
        place = {"response_id": response, "item_id": item, "output_index": 0, "content_index": 0}
        await self.send("response.created", response={"id": response, "status": "in_progress", "output": []})
        size = 2 * round(delta_s * SAMPLE_RATE_HZ)
        status = "completed"
        for start in range(0, len(pcm), size):
            if until():
                status = "cancelled"
                break
            delta = base64.b64encode(pcm[start : start + size]).decode()
            await self.send("response.output_audio.delta", **place, delta=delta)
            await asyncio.sleep(pace * delta_s)
        await self.send("response.output_audio.done", **place)
        message = {"id": item, "type": "message", "role": "assistant", "content": []}
        done = {"id": response, "status": status, "output": [message]}
        await self.send("response.done", response=done)

    async def call(
        self, name: str, arguments: str, *, call: str = "call_1", response: str = "resp_1"
    ) -> None:
        """A response that is a call of a function, and nothing else."""
        item = {"id": f"item_{call}", "type": "function_call", "name": name, "call_id": call}
        whole = {**item, "arguments": arguments, "status": "completed"}
        place = {"response_id": response, "output_index": 0}
        await self.send("response.created", response={"id": response, "status": "in_progress", "output": []})
        await self.send("response.output_item.added", **place, item={**item, "arguments": ""})
        await self.send(
            "response.function_call_arguments.done",
            **place,
            item_id=item["id"],
            call_id=call,
            name=name,
            arguments=arguments,
        )
        await self.send("response.output_item.done", **place, item=whole)
        await self.send("response.done", response={"id": response, "status": "completed", "output": [whole]})

    async def _listen(self) -> None:
        async for message in self.line:
            try:
                event = json.loads(message)
            except (ValueError, RecursionError):
                continue
            if not isinstance(event, dict):
                continue
            self.got.append(event)
            self._news.set()
            if event.get("type") == "session.update":
                self.session |= event["session"]
                await self.send("session.updated", session=self.session)
            elif event.get("type") == "conversation.item.create":
                await self.send("conversation.item.added", item=event["item"])


class ScriptedUpstream:
    """Listens at `url`; each connection gets a part, played by the script."""

    def __init__(self, script: Script, *, port: int = 0, subprotocols: tuple[str, ...] = ()) -> None:
        self.parts: list[Part] = []
        self.requests: list[tuple[str, dict[str, str]]] = []  # path and headers of each
        self.url = ""
        self._script, self._port, self._subprotocols = script, port, subprotocols
        self._server: Server | None = None

    async def __aenter__(self) -> "ScriptedUpstream":
        """Begin to listen."""
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
        """Close all."""
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()

    async def _play(self, line: ServerConnection) -> None:
        assert line.request is not None
        self.requests.append((line.request.path, dict(line.request.headers.raw_items())))
        part = Part(line)
        self.parts.append(part)
        listening = asyncio.create_task(part._listen())
        try:
            await part.send("session.created", session=part.session)
            await self._script(part)
            await listening
        except ConnectionClosed:
            pass  # the client left, or was left
        finally:
            listening.cancel()
