"""Limits on the sockets below the application: their number, their silence, and their pings.

A socket needs no token, so nothing here may grow with what a stranger does. A socket that has not sent a whole request
is silent. It is closed after `SILENCE_S`, or at once if all places are taken and it is the oldest silent one.
"""

import asyncio
import logging
import time
from collections.abc import MutableSet
from typing import Any, ClassVar

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

SILENCE_S = 10.0
CLOSE_S = 3.0  # for a client's answer to our close
SPARE_FILES = 128  # files that are not clients' sockets
WANTED_FILES = 65_536
CONTROL_FRAMES_A_SECOND = 10.0  # pings and pongs of one WebSocket
CONTROL_FRAMES_AT_ONCE = 50.0
MAX_UNREAD_BYTES = 1 << 20  # pongs that a client does not read
MAX_FRAGMENTS = 4_096  # of one message; empty fragments escape the limit on its size
REPEAT_S = 10.0  # a repeated line is logged once in this time


def raise_file_limit(wanted: int = WANTED_FILES) -> int:
    """Raise this process's limit of open files as far as it may; returns the limit."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return wanted
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft == resource.RLIM_INFINITY or soft >= most:
        return wanted if soft == resource.RLIM_INFINITY else soft
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    except (OSError, ValueError):
        return soft
    return most


class RepeatFilter(logging.Filter):
    """Drops log records that repeat a recent one; a full file table would log thousands a second."""

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged."""
        now, text = time.monotonic(), record.getMessage().partition("\n")[0][:80]
        if now - self._logged.get(text, -REPEAT_S) < REPEAT_S:
            return False
        if len(self._logged) > 100:
            self._logged.clear()
        self._logged[text] = now
        return True


class ConnectionGuard:
    """Bounds the sockets of one server, and closes those that stay silent."""

    def __init__(self, limit: int, *, silence_s: float = SILENCE_S) -> None:
        self._limit, self._silence_s = limit, silence_s
        self._silent: dict[Any, asyncio.Transport] = {}  # by protocol, the oldest first

    @property
    def protocol(self) -> type[asyncio.Protocol]:
        """The HTTP protocol of a server under this guard."""
        return type("GuardedHttp", (GuardedHttp,), {"guard": self})

    def enter(self, protocol: Any, transport: asyncio.Transport, connections: MutableSet[Any]) -> None:
        """A socket was opened; `connections` holds all sockets of the server."""
        self._silent[protocol] = transport
        if len(connections) > self._limit:
            self._make_room(connections)
        self._watch(protocol, transport, None)

    def _make_room(self, connections: MutableSet[Any]) -> None:
        """Close a WebSocket whose client does not answer the server's close, or else the oldest silent socket."""
        leaving = next((one for one in connections if getattr(one, "close_sent", False)), None)
        if leaving is not None:
            leaving.transport.abort()
        else:
            self._silent.pop(next(iter(self._silent))).abort()

    def settle(self, protocol: Any) -> None:
        """The socket sent a whole request, or was closed."""
        self._silent.pop(protocol, None)

    def _watch(self, protocol: Any, transport: asyncio.Transport, cycle: object) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(self._silence_s, self._check, protocol, transport, cycle)

    def _check(self, protocol: Any, transport: asyncio.Transport, before: Any) -> None:
        """Close the socket if no request began since the last check and none is being answered."""
        if transport.is_closing() or transport.get_protocol() is not protocol:
            return
        cycle: Any = getattr(protocol, "cycle", None)
        if cycle is before and (cycle is None or cycle.response_complete):
            transport.abort()
        else:
            self._watch(protocol, transport, cycle)


class GuardedHttp(H11Protocol):
    """uvicorn's HTTP protocol, reporting to a guard. It is h11's, which bounds headers (64 KiB), not httptools'."""

    guard: ClassVar[ConnectionGuard]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A socket was opened."""
        super().connection_made(transport)
        self.guard.enter(self, transport, self.connections)

    def data_received(self, data: bytes) -> None:
        """Bytes came; they may complete a request, or begin a WebSocket."""
        super().data_received(data)
        if self.cycle is not None or self not in self.connections:
            self.guard.settle(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """The socket is closed."""
        self.guard.settle(self)
        super().connection_lost(exc)


class GuardedWebSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket, with bounds on control frames and fragments, which the application never sees."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.close_timeout = CLOSE_S
        self._allowance, self._counted_at = CONTROL_FRAMES_AT_ONCE, time.monotonic()

    async def send(self, message: Any) -> None:
        """Send, unless the client is gone: each write to a lost socket would be logged."""
        await self.writable.wait()
        if message["type"] != "websocket.send" or not self.transport.is_closing():
            await super().send(message)

    def handle_ping(self) -> None:
        """Answer a ping, unless the client sends too many or does not read the answers."""
        if self._is_allowed():
            super().handle_ping()

    def handle_pong(self, event: Frame) -> None:
        """Take note of a pong, unless the client sends too many."""
        if self._is_allowed():
            super().handle_pong(event)

    def handle_cont(self, event: Frame) -> None:
        """A fragment of a message."""
        if len(self.frames) < MAX_FRAGMENTS:
            super().handle_cont(event)
        else:
            self.transport.abort()

    def _is_allowed(self) -> bool:
        now = time.monotonic()
        earned = (now - self._counted_at) * CONTROL_FRAMES_A_SECOND
        self._allowance, self._counted_at = min(CONTROL_FRAMES_AT_ONCE, self._allowance + earned) - 1, now
        is_read = self.transport.get_write_buffer_size() < MAX_UNREAD_BYTES
        if self._allowance >= 0 and is_read:
            return True
        if not self.transport.is_closing():
            self.transport.abort()
        return False


class OneBodyLength:
    """Refuses a request that states its length twice, because a proxy may read it differently (request smuggling)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 400, or pass the request on."""
        names = [name for name, _ in scope.get("headers", ())]
        if b"transfer-encoding" in names and b"content-length" in names:
            text = "send Content-Length or Transfer-Encoding, not both"
            await PlainTextResponse(text, 400, {"connection": "close"})(scope, receive, send)
        else:
            await self._app(scope, receive, send)
