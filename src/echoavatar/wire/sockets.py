"""Bounds on the sockets that any client may open: their number, the time they stay silent, and the lines they log.

Opening a socket needs no token, so nothing here may grow with the client's actions. A socket that has not sent a whole
request is silent. It is closed after `SILENCE_S`, or at once if all places are taken and it is the oldest silent one.
This module needs uvicorn, so only servers import it.
"""

import asyncio
import logging
import socket
import time
from collections.abc import MutableSet
from functools import partial
from typing import Any, ClassVar

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from echoavatar.errors import EchoAvatarError

SILENCE_S = 10.0
SPARE_FILES = 128  # files that are not clients' sockets
WANTED_FILES = 65_536
REPEAT_S = 10.0  # a repeated line is logged once in this time
NOISY_LOGS = ("asyncio", "uvicorn.error")  # any client can make them log


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; port 0 takes any free one.

    Raises:
        EchoAvatarError: the port is taken, or may not be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # With the protocol named, asyncio sets TCP_NODELAY: small messages leave at once.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(1024)
    except OSError as error:
        listener.close()
        raise EchoAvatarError(
            f"cannot listen on {host} port {port}: {error.strerror}; choose another --host or --port"
        ) from error
    return listener


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


def hurry_handshakes() -> None:
    """Give clients of this loop's later servers `SILENCE_S` for the TLS handshake; asyncio gives them a minute."""
    loop = asyncio.get_running_loop()
    listens = partial(loop.create_server, ssl_handshake_timeout=SILENCE_S)
    loop.create_server = listens  # type: ignore[method-assign]


def log_less() -> None:
    """Log a line that any client can cause only once per `REPEAT_S`."""
    for name in NOISY_LOGS:
        log = logging.getLogger(name)
        if not any(isinstance(known, RepeatFilter) for known in log.filters):
            log.addFilter(RepeatFilter())


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
