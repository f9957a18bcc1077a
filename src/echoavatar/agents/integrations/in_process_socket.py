"""A WebSocket to an ASGI application in this process, without a network socket."""

import asyncio
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from websockets.exceptions import ConnectionClosed, ConnectionClosedError, ConnectionClosedOK
from websockets.frames import Close

from echoavatar.wire import subprotocol

Message = MutableMapping[str, Any]
Application = Callable[
    [Message, Callable[[], Awaitable[Message]], Callable[[Message], Awaitable[None]]], Awaitable[None]
]
MAX_QUEUED_FRAMES = 1024  # messages for a reader that does not read


class InProcessSocket:
    """The client's side of one WebSocket connection to an ASGI application."""

    def __init__(self, app: Application, path: str = "/v1/stream") -> None:
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "path": path,
            "headers": [],
            "subprotocols": [subprotocol("msgpack")],
        }
        self._out: asyncio.Queue[Message] = asyncio.Queue()
        self._in: asyncio.Queue[Message] = asyncio.Queue(MAX_QUEUED_FRAMES)
        self._closed: ConnectionClosed | None = None
        self._out.put_nowait({"type": "websocket.connect"})
        self._serving = asyncio.ensure_future(self._serve(app, scope))

    async def send(self, message: bytes) -> None:
        """Send one frame to the application.

        Raises:
            ConnectionClosed: the application has closed the connection.
        """
        if self._closed is not None:
            raise self._closed
        await self._out.put({"type": "websocket.receive", "bytes": message})

    async def recv(self, *, decode: bool | None = None) -> bytes:
        """Receive the next frame from the application.

        Raises:
            ConnectionClosed: the application has closed the connection.
        """
        del decode  # frames are always bytes
        while self._closed is None or not self._in.empty():
            message = await self._in.get()
            if message["type"] == "websocket.send":
                frame: bytes = message["bytes"]
                return frame
            if message["type"] == "websocket.close" and self._closed is None:
                self._close(message.get("code", 1000), message.get("reason") or "")
        raise self._closed or ConnectionClosedOK(None, None)

    async def close(self) -> None:
        """Close the connection and wait until the application has ended."""
        if self._closed is None:
            self._close(1000, "")
        await self._out.put({"type": "websocket.disconnect", "code": 1000})
        while not self._serving.done():  # the application may be blocked on a frame that is never read
            while not self._in.empty():
                self._in.get_nowait()
            await asyncio.wait([self._serving], timeout=0.05)
        self._in.put_nowait({"type": "websocket.close"})  # wakes a pending `recv`

    def _close(self, code: int, reason: str) -> None:
        kind = ConnectionClosedOK if code in (1000, 1001) else ConnectionClosedError
        self._closed = kind(Close(code, reason), None)

    async def _serve(self, app: Application, scope: Message) -> None:
        try:
            await app(scope, self._out.get, self._in.put)
        finally:
            if self._in.full():  # room for the close message
                self._in.get_nowait()
            self._in.put_nowait({"type": "websocket.close", "code": 1006})
