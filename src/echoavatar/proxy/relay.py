"""Both directions of a Realtime connection, byte for byte and in order; the avatar only listens in.

An event is sent on first, and only then shown to the avatar's side, which takes it without waiting and cannot raise.
Two things alone are not passed on as they came, and both only where asked for: a `session.update` with tools gets the
avatar's added (`--tools`), and events of the client's whose type begins with `echoavatar.` are for us.
"""

import asyncio
import json
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.connection import Connection
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from ..errors import EchoAvatarError
from ..wire import ProtocolError
from ..wire.guard import check_origin
from .link import AvatarLink
from .settings import ProxySettings
from .upstream import MAX_BYTES, PING_S, PONG_S, InvalidStatus, dial, quiet_logger, upstream_url

_LOG = logging.getLogger(__name__)
_UNSENDABLE = (1005, 1006, 1015)  # close codes that mean "none was sent"
DROPPED = 1011
CANCEL_AGAIN_S = 0.5


class Relay:
    """Listens for clients; each gets an upstream connection and an avatar of its own."""

    def __init__(self, settings: ProxySettings) -> None:
        self._settings = settings
        self._lines: dict[ServerConnection, ClientConnection] = {}
        self._watching: set[asyncio.Task[None]] = set()
        self._server: Server | None = None

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._lines)

    async def start(self, host: str = "127.0.0.1", port: int = 8766) -> int:
        """Begin to listen; port 0 takes any free one. Returns the port.

        Raises:
            EchoAvatarError: the port is taken, or not ours to take.
        """
        try:
            self._server = await serve(
                self._meet,
                host,
                port,
                process_request=self._admit,
                select_subprotocol=self._subprotocol,
                compression=None,
                max_size=MAX_BYTES,
                ping_interval=PING_S,
                ping_timeout=PONG_S,
                server_header=None,
                logger=quiet_logger(),
            )
        except OSError as error:
            raise EchoAvatarError(
                f"cannot listen on {host} port {port}: {error.strerror}; choose another --host or --port"
            ) from error
        return int(next(iter(self._server.sockets)).getsockname()[1])

    async def stop(self) -> None:
        """Close all connections."""
        if self._server is not None:
            self._server.close(code=1001, reason="the proxy stops")
            await self._server.wait_closed()

    # ---- the handshake

    async def _admit(self, client: ServerConnection, request: Request) -> Response | None:
        """Dial the upstream before the client is let in, so that a refusal is the upstream's own."""
        if request.path == "/health":
            return _answer(HTTPStatus.OK, json.dumps({"status": "ready", "clients": self.clients}))
        if "websocket" not in request.headers.get("Upgrade", "").lower():
            return None  # the library refuses it in words
        try:
            check_origin({key.lower(): value for key, value in request.headers.raw_items()}, self._origins)
            url = upstream_url(self._settings.upstream, request.path)
            offered = [
                name.strip()
                for line in request.headers.get_all("Sec-WebSocket-Protocol")
                for name in line.split(",")
            ]
            self._lines[client] = await dial(url, request.headers.raw_items(), offered)
        except ProtocolError as error:
            return _answer(HTTPStatus.FORBIDDEN, str(error))
        except InvalidStatus as refused:
            answer = refused.response
            return _answer(
                HTTPStatus(answer.status_code),
                bytes(answer.body or b""),
                answer.headers.get("Content-Type", "text/plain"),
            )
        except (OSError, TimeoutError, InvalidHandshake) as error:
            _LOG.warning("the upstream cannot be reached: %s", type(error).__name__)
            return _answer(HTTPStatus.BAD_GATEWAY, f"the upstream cannot be reached: {type(error).__name__}")
        watch = asyncio.create_task(self._forget(client))
        self._watching.add(watch)
        watch.add_done_callback(self._watching.discard)
        return None

    @property
    def _origins(self) -> tuple[str, ...]:
        return self._settings.origins

    def _subprotocol(self, client: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol | None:
        """What the upstream chose."""
        del offered
        line = self._lines.get(client)
        return line.subprotocol if line is not None else None

    async def _forget(self, client: ServerConnection) -> None:
        """The upstream's connection ends with the client's, however that came about."""
        await client.wait_closed()
        line = self._lines.pop(client, None)
        if line is not None:
            await line.close(*_farewell(client))

    # ---- the conversation

    async def _meet(self, client: ServerConnection) -> None:
        line = self._lines[client]
        link = AvatarLink(self._settings, client=client, upstream=line)
        avatar = asyncio.create_task(link.run())
        try:
            down = asyncio.create_task(_pass_on(line, client, link.hear_server))
            up = asyncio.create_task(_pass_on(client, line, link.hear_client, link.rewrite))
            await asyncio.wait((down, up), return_when=asyncio.FIRST_COMPLETED)
            if down.done():  # what came from upstream before it closed has been sent
                await client.close(*_farewell(line))
            else:
                await line.close(*_farewell(client))
            await _end(down, up)
        finally:
            await _end(avatar)


async def _end(*tasks: asyncio.Task[None]) -> None:
    """Cancel until they are done: what they wait for may swallow a cancellation (`asyncio.wait_for` before 3.12)."""
    while running := [task for task in tasks if not task.done()]:
        for task in running:
            task.cancel()
        await asyncio.wait(running, timeout=CANCEL_AGAIN_S)
    for task in tasks:
        if not task.cancelled():
            task.result()  # what went wrong is not lost


async def _pass_on(
    source: Connection,
    sink: Connection,
    tap: Callable[[str | bytes], None],
    rewrite: Callable[[str | bytes], str | bytes | None] | None = None,
) -> None:
    """All messages, in order, until either side has had enough."""
    with suppress(ConnectionClosed):
        while True:
            message = await source.recv()
            sent = message if rewrite is None else rewrite(message)
            if sent is not None:
                await sink.send(sent)
            tap(message)


def _farewell(line: Connection) -> tuple[int, str]:
    """How one side ended it, to be told to the other; where it fell silent instead, that it did."""
    code = line.close_code
    if code is None or code in _UNSENDABLE:
        return (1000, "") if code == 1005 else (DROPPED, "the other side dropped the connection")
    return code, line.close_reason or ""


def _answer(status: HTTPStatus, body: str | bytes, kind: str = "application/json") -> Response:
    content = body.encode() if isinstance(body, str) else body
    headers = Headers(
        [("Content-Type", kind), ("Content-Length", str(len(content))), ("Connection", "close")]
    )
    return Response(status.value, status.phrase, headers, content)
