"""Forward a Realtime connection both ways, byte for byte and in order; the avatar only listens in.

An event is forwarded first and shown to the avatar's sidecar afterwards, which takes it without waiting and cannot
raise. Two kinds of event are not forwarded unchanged: with `--tools`, a `session.update` that sets tools gets the
avatar's tools added, and client events whose type begins with `echoavatar.` end at the proxy.
"""

import asyncio
import json
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from http import HTTPStatus

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.connection import Connection
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from echoavatar.errors import DependencyError
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.guard import check_origin, is_own_host
from echoavatar.wire.sockets import serve_websockets, wrong_host

from ..client.connection import quiet_logger
from .conversation import Conversation
from .sidecar import AvatarSidecar
from .upstream import HANDSHAKE_TIMEOUT_S, MAX_BYTES, PING_S, PONG_S, ProxySettings, dial, refusal_headers, upstream_url

_LOG = logging.getLogger(__name__)
_UNSENDABLE = (1005, 1006, 1015)  # codes that mean "no close code was sent"
DROPPED = 1011
CANCEL_AGAIN_S = 0.5
FILES_OF_A_CLIENT = 3  # sockets: its own connection, the upstream's and the avatar's


class Relay:
    """Listens for clients; each client gets its own upstream connection and its own avatar."""

    def __init__(self, settings: ProxySettings) -> None:
        self._settings = settings
        self._upstreams: dict[ServerConnection, ClientConnection] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._server: Server | None = None
        self._names = settings.origins  # names of the proxy in requests, beside localhost and addresses

    @property
    def clients(self) -> int:
        """The number of connected clients."""
        return len(self._upstreams)

    async def start(self, host: str = "127.0.0.1", port: int = 8766) -> int:
        """Start to listen and return the port; port 0 takes any free one. Raises as `wire.sockets.listen`."""
        self._names = (*self._settings.origins, host)
        self._server = await serve_websockets(
            self._serve_client,
            host,
            port,
            files_each=FILES_OF_A_CLIENT,
            noisy_logs=(_LOG.name, AvatarSidecar.__module__, Conversation.__module__, quiet_logger().name),
            process_request=self._process_request,
            select_subprotocol=self._subprotocol,
            compression=None,
            max_size=MAX_BYTES,
            open_timeout=HANDSHAKE_TIMEOUT_S,
            ping_interval=PING_S,
            ping_timeout=PONG_S,
            server_header=None,
            logger=quiet_logger(),
        )
        return int(next(iter(self._server.sockets)).getsockname()[1])

    async def stop(self) -> None:
        """Stop listening and close all connections."""
        if self._server is not None:
            self._server.close(code=1001, reason="the proxy is stopping")
            await self._server.wait_closed()

    # ---- the handshake

    async def _process_request(self, client: ServerConnection, request: Request) -> Response | None:
        """Connect upstream before accepting the client, so that the client sees the upstream's own refusal."""
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        if "host" in headers and not is_own_host(headers["host"], self._names):
            return client.respond(HTTPStatus.MISDIRECTED_REQUEST, wrong_host(headers["host"]))
        if request.path == "/health":
            health = client.respond(HTTPStatus.OK, json.dumps({"status": "ready", "clients": self.clients}))
            del health.headers["Content-Type"]
            health.headers["Content-Type"] = "application/json"
            return health
        if "websocket" not in request.headers.get("Upgrade", "").lower():
            return None  # the websockets library answers it
        try:
            check_origin(headers, self._settings.origins)
            url = upstream_url(self._settings.upstream, request.path)
            offered = [
                name.strip() for line in request.headers.get_all("Sec-WebSocket-Protocol") for name in line.split(",")
            ]
            self._upstreams[client] = await dial(url, request.headers.raw_items(), offered)
        except ProtocolError as error:
            return client.respond(HTTPStatus.FORBIDDEN, str(error))
        except InvalidStatus as refused:
            return _refusal(client, refused.response)
        except TimeoutError as error:
            _LOG.warning("%s", error)
            return client.respond(HTTPStatus.GATEWAY_TIMEOUT, str(error))
        except (OSError, WebSocketException, DependencyError) as error:
            why = error if isinstance(error, DependencyError) else type(error).__name__
            _LOG.warning("the upstream cannot be reached: %s", why)
            return client.respond(HTTPStatus.BAD_GATEWAY, f"the upstream cannot be reached: {why}")
        closing = asyncio.create_task(self._close_upstream(client))
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)
        return None

    def _subprotocol(self, client: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol | None:
        """The subprotocol that the upstream chose."""
        del offered
        upstream = self._upstreams.get(client)
        return upstream.subprotocol if upstream is not None else None

    async def _close_upstream(self, client: ServerConnection) -> None:
        """Close the upstream connection when the client's ends, for whatever reason."""
        await client.wait_closed()
        upstream = self._upstreams.pop(client, None)
        if upstream is not None:
            await upstream.close(*_close_reason(client))

    # ---- the conversation

    async def _serve_client(self, client: ServerConnection) -> None:
        upstream = self._upstreams[client]
        sidecar = AvatarSidecar(self._settings, client=client, upstream=upstream)
        avatar = asyncio.create_task(sidecar.run())
        try:
            of_model, of_client = (partial(sidecar.observe, is_server=is_server) for is_server in (True, False))
            down = asyncio.create_task(_forward(upstream, client, of_model))
            up = asyncio.create_task(_forward(client, upstream, of_client, sidecar.rewrite))
            await asyncio.wait((down, up), return_when=asyncio.FIRST_COMPLETED)
            if down.done():  # everything that arrived from upstream before it closed has been sent
                await client.close(*_close_reason(upstream))
            else:
                await upstream.close(*_close_reason(client))
            await _cancel(down, up)
        finally:
            await _cancel(avatar)


async def _cancel(*tasks: asyncio.Task[None]) -> None:
    """Cancel until all are done: `asyncio.wait_for` before 3.12 may swallow a cancellation."""
    while running := [task for task in tasks if not task.done()]:
        for task in running:
            task.cancel()
        await asyncio.wait(running, timeout=CANCEL_AGAIN_S)
    for task in tasks:
        if not task.cancelled():
            task.result()  # raise what went wrong


async def _forward(
    source: Connection,
    sink: Connection,
    tap: Callable[[str | bytes], None],
    rewrite: Callable[[str | bytes], str | bytes | None] | None = None,
) -> None:
    """Forward all messages in order until either connection closes."""
    with suppress(ConnectionClosed):
        while True:
            message = await source.recv()
            sent = message if rewrite is None else rewrite(message)
            if sent is not None:
                await sink.send(sent)
            tap(message)


def _close_reason(connection: Connection) -> tuple[int, str]:
    """The code and reason with which one side closed, for the other side; DROPPED if it closed without any."""
    code = connection.close_code
    if code is None or code in _UNSENDABLE:
        return (1000, "") if code == 1005 else (DROPPED, "the other side dropped the connection")
    return code, connection.close_reason or ""


def _refusal(client: ServerConnection, answer: Response) -> Response:
    """The upstream's refusal for the client: the same status, reason, headers and body."""
    if answer.status_code < 200 or 300 <= answer.status_code < 400:
        return client.respond(
            HTTPStatus.BAD_GATEWAY,
            f"the upstream answered with status {answer.status_code}; the proxy follows no redirects",
        )
    content = bytes(answer.body or b"")
    length = [] if answer.status_code == HTTPStatus.NO_CONTENT else [("Content-Length", str(len(content)))]
    headers = Headers([*refusal_headers(answer.headers.raw_items()), *length, ("Connection", "close")])
    return Response(answer.status_code, answer.reason_phrase, headers, content)
