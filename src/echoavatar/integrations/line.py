"""A line to an application in this process: what a WebSocket would carry, without a socket."""

import asyncio
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from websockets.exceptions import ConnectionClosed, ConnectionClosedError, ConnectionClosedOK
from websockets.frames import Close

from ..wire import subprotocol

Message = MutableMapping[str, Any]
Application = Callable[
    [Message, Callable[[], Awaitable[Message]], Callable[[Message], Awaitable[None]]], Awaitable[None]
]
MOST_WAITING = 1024  # messages to a reader that does not read


class MemoryLine:
    """One WebSocket of an ASGI application, from the client's side."""

    def __init__(self, app: Application, path: str = "/v1/stream") -> None:
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "path": path,
            "headers": [],
            "subprotocols": [subprotocol("msgpack")],
        }
        self._out: asyncio.Queue[Message] = asyncio.Queue()
        self._in: asyncio.Queue[Message] = asyncio.Queue(MOST_WAITING)
        self._closed: ConnectionClosed | None = None
        self._out.put_nowait({"type": "websocket.connect"})
        self._visit = asyncio.ensure_future(self._serve(app, scope))

    async def send(self, message: bytes) -> None:
        """One frame to the application.

        Raises:
            ConnectionClosed: it has closed the line.
        """
        if self._closed is not None:
            raise self._closed
        await self._out.put({"type": "websocket.receive", "bytes": message})

    async def recv(self, *, decode: bool | None = None) -> bytes:
        """The next frame from the application.

        Raises:
            ConnectionClosed: it has closed the line.
        """
        del decode  # frames are bytes
        while self._closed is None or not self._in.empty():
            told = await self._in.get()
            if told["type"] == "websocket.send":
                frame: bytes = told["bytes"]
                return frame
            if told["type"] == "websocket.close" and self._closed is None:
                self._close(told.get("code", 1000), told.get("reason") or "")
        raise self._closed or ConnectionClosedOK(None, None)

    async def close(self) -> None:
        """Say goodbye, and wait until the application has noticed."""
        if self._closed is None:
            self._close(1000, "")
        await self._out.put({"type": "websocket.disconnect", "code": 1000})
        while not self._visit.done():  # it may be stuck on a frame that nobody reads
            while not self._in.empty():
                self._in.get_nowait()
            await asyncio.wait([self._visit], timeout=0.05)
        self._in.put_nowait({"type": "websocket.close"})  # whoever still reads learns of it

    def _close(self, code: int, reason: str) -> None:
        kind = ConnectionClosedOK if code in (1000, 1001) else ConnectionClosedError
        self._closed = kind(Close(code, reason), None)

    async def _serve(self, app: Application, scope: Message) -> None:
        try:
            await app(scope, self._out.get, self._in.put)
        finally:
            if self._in.full():  # the reader must learn that it is over
                self._in.get_nowait()
            self._in.put_nowait({"type": "websocket.close", "code": 1006})
