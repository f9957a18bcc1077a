"""The one way to open a listening socket, and the limits on the sockets that any client may open.

Opening a socket needs no token, so a client must not be able to raise the number of sockets, the time for which they
stay silent, or the number of lines in the log. A socket is silent while its client has not sent a whole request, or
does not read our answer. It is closed after a while, or at once if all places are taken and it has been silent for
longest. This module needs uvicorn and websockets, so only servers import it.
"""

import asyncio
import logging
import socket
import ssl
import time
from asyncio.sslproto import SSLProtocol
from collections.abc import Awaitable, Callable, MutableSet
from contextlib import suppress
from typing import Any, ClassVar

import uvicorn
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from websockets.asyncio.server import Server as WebSocketServer
from websockets.asyncio.server import ServerConnection
from websockets.asyncio.server import serve as start_websockets
from websockets.protocol import Event

from echoavatar.errors import EchoAvatarError

from .guard import check_certificate, is_own_host

SILENCE_S = 10.0
BODY_S = 60.0  # for the rest of a request whose headers have come
UNREAD_S = 60.0  # without reading more of our answer; a slow client takes as long for what the kernel buffers
CONNECTIONS = 4_096  # sockets, besides the avatar's WebSockets; a browser opens six
SPARE_FILES = 128  # files that are not clients' sockets
WANTED_FILES = 65_536
BACKLOG = 1_024
REPEAT_S = 10.0  # a repeated line is logged once in this time
NOISY_LOGS = ("asyncio", "uvicorn.error")  # loggers to which any client can make the server write
_REFUSAL_HEADERS = {
    "connection": "close",
    "content-security-policy": "default-src 'none'",
    "x-content-type-options": "nosniff",
}


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; port 0 takes any free one.

    Raises EchoAvatarError if the port is taken, or may not be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio sets TCP_NODELAY, which sends small messages at once, only where the protocol is named.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(BACKLOG)
    except (OSError, OverflowError, ValueError) as error:  # also for an invalid port or host name
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise EchoAvatarError(f"cannot listen on {host} port {port}: {reason}; choose another host or port") from error
    return listener


class WebServer(uvicorn.Server):
    """Serves an ASGI application on one guarded socket, which the constructor opens; `address` is its URL.

    `names` are hosts and origins by which requests may name this server, beside `localhost` and IP addresses; None: any
    (see `RequestChecks`). `X-Forwarded-For` and `X-Forwarded-Proto` count only if they come from `proxies` (addresses
    or networks). `on_ready` is called with the address. Further options are uvicorn's. Raises EchoAvatarError
    if the port is taken, or may not be used; or the certificate or its key cannot be used.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        host: str,
        port: int,
        names: tuple[str, ...] | None,
        connections: int = CONNECTIONS,
        on_ready: Callable[[str], None] | None = None,
        certificate: str | None = None,
        key: str | None = None,
        proxies: tuple[str, ...] = (),
        **options: Any,
    ) -> None:
        if certificate:
            check_certificate(certificate, key)
        guard = ConnectionGuard(count_places(connections))
        log_less()
        self._listener, self._on_ready = listen(host, port), on_ready
        self.address = f"{'https' if certificate else 'http'}://{address_of(host, self._listener.getsockname()[1])}"
        config = uvicorn.Config(
            RequestChecks(app, None if names is None else (*names, host)),
            http=guard.protocol,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=bool(proxies),
            forwarded_allow_ips=list(proxies),
            timeout_graceful_shutdown=5,
            backlog=BACKLOG,
            loop="asyncio" if certificate else "auto",  # GuardedTls needs asyncio's event loop
            ssl_certfile=certificate,
            ssl_keyfile=key,
            **options,
        )
        super().__init__(config)

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until SIGINT or SIGTERM, or until `should_exit` is set."""
        with self._listener:
            await super().serve([self._listener, *(sockets or ())])

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer, and call `on_ready`."""
        http, context = self.config.http_protocol_class, self.config.ssl
        if context is not None:  # asyncio's own TLS would hide sockets that are still in the handshake
            self.config.http_protocol_class = lambda **given: GuardedTls(http(**given), context)  # type: ignore
            self.config.ssl = None
        await super().startup(sockets)
        if self.started and self._on_ready is not None:
            self._on_ready(self.address)


async def serve_websockets(
    handler: Callable[[ServerConnection], Awaitable[None]],
    host: str,
    port: int,
    *,
    files_each: int = 1,
    noisy_logs: tuple[str, ...] = (),
    **options: Any,
) -> WebSocketServer:
    """Start a server of the websockets library on a guarded socket. A connection needs `files_each` open files.

    Loggers in `noisy_logs` log repeated lines less often. Further options are the library's. Raises as `listen`.
    """
    log_less(*noisy_logs)
    guard = ConnectionGuard(count_places(CONNECTIONS, files_each=files_each))
    return await start_websockets(
        handler, sock=listen(host, port), backlog=BACKLOG, create_connection=guard.websocket, **options
    )


def address_of(host: str, port: int) -> str:
    """Host and port for a URL."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def count_places(wanted: int, *, files_each: int = 1) -> int:
    """How many connections may be open: `wanted`, or fewer if this process may not open as many files; at least 16."""
    return max(16, min(wanted, (raise_file_limit() - SPARE_FILES) // files_each))


def raise_file_limit(wanted: int = WANTED_FILES) -> int:
    """Raise this process's limit of open files as far as it may; returns the limit."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return wanted
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    soft, hard = (wanted if limit == resource.RLIM_INFINITY else limit for limit in limits)
    if soft < min(wanted, hard):
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(wanted, hard), limits[1]))
            return min(wanted, hard)
    return soft


def log_less(*names: str) -> None:
    """Make the loggers of `NOISY_LOGS` and of `names` log a repeated line only once per `REPEAT_S`."""
    for name in (*NOISY_LOGS, *names):
        log = logging.getLogger(name)
        if not any(isinstance(known, RepeatFilter) for known in log.filters):
            log.addFilter(RepeatFilter())


class RepeatFilter(logging.Filter):
    """Drops log records that repeat a recent one; a full file table would log thousands a second."""

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged. Records whose templates begin alike count as equal."""
        now, text = time.monotonic(), str(record.msg).partition("\n")[0][:80]
        if now - self._logged.get(text, -REPEAT_S) < REPEAT_S:
            return False
        if len(self._logged) > 100:
            self._logged.clear()
        self._logged[text] = now
        return True


class ConnectionGuard:
    """Bounds the sockets of one server, and closes those that stay silent."""

    def __init__(self, places: int, *, silence_s: float = SILENCE_S) -> None:
        self._places, self._silence_s = places, silence_s
        self._silent: dict[Any, tuple[asyncio.Transport, asyncio.TimerHandle]] = {}  # by protocol, the oldest first

    @property
    def protocol(self) -> type[asyncio.Protocol]:
        """The HTTP protocol of a server of uvicorn under this guard."""
        return type("GuardedHttp", (GuardedHttp,), {"guard": self})

    @property
    def websocket(self) -> type[ServerConnection]:
        """The connections of a server of the websockets library under this guard."""
        return type("GuardedConnection", (GuardedConnection,), {"guard": self, "connections": set()})

    def enter(self, protocol: Any, transport: asyncio.Transport, connections: MutableSet[Any]) -> None:
        """A socket was opened; `connections` holds all sockets of the server."""
        self.expect(protocol, transport)
        if len(connections) > self._places:
            self._make_room(connections)

    def expect(self, protocol: Any, transport: asyncio.Transport, seconds: float | None = None) -> None:
        """The client must now send a request or the rest of one, or read our answer; until then it is silent."""
        self.settle(protocol)
        unread = transport.get_write_buffer_size()
        loop = asyncio.get_running_loop()
        timer = loop.call_later(self._silence_s if seconds is None else seconds, self._expire, protocol, unread)
        self._silent[protocol] = (transport, timer)

    def settle(self, protocol: Any) -> None:
        """The client did what was expected, or the socket was closed."""
        if protocol in self._silent:
            _, timer = self._silent.pop(protocol)
            timer.cancel()

    def _make_room(self, connections: MutableSet[Any]) -> None:
        """Close a WebSocket whose client does not answer the server's close, or else the oldest silent socket."""
        leaving = next((one for one in connections if getattr(one, "close_sent", False)), None)
        if leaving is not None:
            leaving.transport.abort()
        else:
            self._close(next(iter(self._silent)))

    def _expire(self, protocol: Any, unread: int) -> None:
        transport, _ = self._silent[protocol]
        if 0 < transport.get_write_buffer_size() < unread:  # slow, but it does read
            self.expect(protocol, transport, UNREAD_S)
        else:
            self._close(protocol)

    def _close(self, protocol: Any) -> None:
        transport, timer = self._silent.pop(protocol)
        timer.cancel()
        transport.abort()


class GuardedHttp(H11Protocol):
    """uvicorn's HTTP protocol, reporting to a guard. It is h11's, which bounds headers (64 KiB), not httptools'."""

    guard: ClassVar[ConnectionGuard]
    handshake: "GuardedTls | None" = None
    _begun: object = None  # the newest request whose headers have come

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A socket was opened, and TLS agreed on."""
        super().connection_made(transport)
        if self.handshake is not None:
            self.handshake.finish()
        self.guard.enter(self, transport, self.connections)

    def handle_events(self) -> None:
        """Handle bytes that came: a request may be complete or lack its body, or the socket became a WebSocket's."""
        super().handle_events()
        if self not in self.connections:
            self.guard.settle(self)
        elif self._is_answering:
            if not self.cycle.more_body:
                self.guard.settle(self)
            elif self.cycle is not self._begun:
                self._begun = self.cycle
                self.guard.expect(self, self.transport, BODY_S)

    def on_response_complete(self) -> None:
        """The answer is written; the next request is due, once the client has read it."""
        unread = self.transport.get_write_buffer_size()
        self.guard.expect(self, self.transport, UNREAD_S if unread else None)
        super().on_response_complete()

    def pause_writing(self) -> None:
        """The client has to read first."""
        super().pause_writing()
        self.guard.expect(self, self.transport, UNREAD_S)

    def resume_writing(self) -> None:
        """The client has read."""
        super().resume_writing()
        if self._is_answering:
            self.guard.settle(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """The socket is closed."""
        self.guard.settle(self)
        super().connection_lost(exc)

    @property
    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete


class GuardedTls(SSLProtocol):
    """TLS in front of HTTP, reporting to HTTP's guard until the handshake is over."""

    max_size = 16 * 1024  # bytes of buffer, one TLS record; asyncio's own 256 KiB are 1 GB at `CONNECTIONS` sockets

    def __init__(self, http: GuardedHttp, context: ssl.SSLContext) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(loop, http, context, None, server_side=True)  # type: ignore[arg-type]  # nobody awaits it
        self._http = http
        http.handshake = self

    def connection_made(self, transport: Any) -> None:
        """A socket was opened."""
        super().connection_made(transport)
        self._socket = transport
        self._http.connections.add(self)  # type: ignore[arg-type]
        self._http.guard.enter(self, transport, self._http.connections)

    def connection_lost(self, exc: BaseException | None) -> None:
        """The socket is closed."""
        self.finish()
        super().connection_lost(exc)

    def finish(self) -> None:
        """The handshake is over; from here on the HTTP protocol reports for this socket."""
        self._http.connections.discard(self)
        self._http.guard.settle(self)

    def shutdown(self) -> None:
        """The server stops."""
        self._socket.abort()


class GuardedConnection(ServerConnection):
    """A connection of the websockets library, reporting to a guard."""

    guard: ClassVar[ConnectionGuard]
    connections: ClassVar[set[ServerConnection]]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A socket was opened."""
        super().connection_made(transport)
        self.connections.add(self)
        self.guard.enter(self, self.transport, self.connections)

    def process_event(self, event: Event) -> None:
        """A request or a frame came."""
        super().process_event(event)
        self.guard.settle(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """The socket is closed."""
        self.connections.discard(self)
        self.guard.settle(self)
        super().connection_lost(exc)


class RequestChecks:
    """Refuses requests before the application sees them, and answers those that a stop of the server cuts off.

    A request that states its length twice gets 400, because a proxy may read it differently (request smuggling). A
    request that names another host gets 421: a page may point its own host name at this server (DNS rebinding) and
    would then read all that needs no token. A server with a token has nothing to read, and passes None for `names`.
    """

    def __init__(self, app: ASGIApp, names: tuple[str, ...] | None) -> None:
        self._app, self._names = app, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, or pass the request on."""
        refusal = None if scope["type"] == "lifespan" else self._refusal(Headers(scope=scope))
        if scope["type"] != "http":
            await (refusal or self._app)(scope, receive, send)
            return
        has_begun = False

        async def note(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await (refusal or self._app)(scope, receive, note)
        except asyncio.CancelledError:  # the server stops; uvicorn would answer 500 and log a traceback
            if not has_begun:
                await PlainTextResponse("the server stopped", 503, _REFUSAL_HEADERS)(scope, receive, send)

    def _refusal(self, headers: Headers) -> PlainTextResponse | None:
        if "transfer-encoding" in headers and "content-length" in headers:
            text = "send Content-Length or Transfer-Encoding, not both"
            return PlainTextResponse(text, 400, _REFUSAL_HEADERS)
        host = headers.get("host")
        if self._names is None or host is None or is_own_host(host, self._names):
            return None
        return PlainTextResponse(wrong_host(host), 421, _REFUSAL_HEADERS)


def wrong_host(host: str) -> str:
    """The text of the refusal of a request that names this host."""
    name = host.partition(":")[0][:80]
    return f"this server does not answer as {name!r}; start it with --origin https://{name}"
