"""The process: uvicorn with our limits, and a shutdown that lets speech end."""

import asyncio
import gc
import socket
from collections.abc import Callable

import uvicorn
from starlette.applications import Starlette

from echoavatar.errors import EchoAvatarError
from echoavatar.wire import MAX_MESSAGE_BYTES
from echoavatar.wire.guard import check_certificate
from echoavatar.wire.sockets import SPARE_FILES, ConnectionGuard, hurry_handshakes, listen, log_less, raise_file_limit

from .transport import GuardedWebSocket

HTTP_CONNECTIONS = 4_096  # beside the WebSockets


class Server(uvicorn.Server):
    """Drains the sessions before the connections are closed; a second signal ends it at once."""

    def __init__(self, app: Starlette, config: uvicorn.Config, on_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._app, self._on_ready = app, on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen, and call `on_ready`."""
        if self.config.ssl is not None:
            hurry_handshakes()
        await super().startup(sockets)
        if self.started:
            self._on_ready()

    async def on_tick(self, counter: int) -> bool:
        """Whether to stop: also if the engine failed for good, so that whoever started us can start us again."""
        return await super().on_tick(counter) or self._app.state.manager.failure is not None

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain the sessions, then close the connections."""
        drain = asyncio.ensure_future(self._app.state.manager.drain())
        while not drain.done() and not self.force_exit:
            await asyncio.wait([drain], timeout=0.1)
        drain.cancel()
        await super().shutdown(sockets)


def serve(
    app: Starlette,
    *,
    host: str = "127.0.0.1",
    port: int = 8765,
    on_ready: Callable[[str], None] | None = None,
    ssl_certfile: str | None = None,
    ssl_keyfile: str | None = None,
) -> None:
    """Serve until SIGINT or SIGTERM; port 0 takes any free one. `on_ready` receives the address.

    Raises:
        EchoAvatarError: the port is taken, or may not be used; the certificate or its key cannot be used; or the engine
            failed again and again.
    """
    if ssl_certfile:
        check_certificate(ssl_certfile, ssl_keyfile)
    listener = listen(host, port)
    name = f"[{host}]" if ":" in host else host
    address = f"{'https' if ssl_certfile else 'http'}://{name}:{listener.getsockname()[1]}"
    gc.collect()
    gc.set_threshold(700, 10, 10)  # Python's own: the command line raised it for the start
    gc.freeze()  # what was loaded stays: else Python lets 100,000 objects of garbage gather before it looks for cycles
    config = configure(app, ssl_certfile=ssl_certfile, ssl_keyfile=ssl_keyfile)
    with listener:
        Server(app, config, lambda: on_ready(address) if on_ready else None).run(sockets=[listener])
    if (failure := app.state.manager.failure) is not None:
        raise EchoAvatarError(f"the engine failed again and again, at last with: {failure}")


def configure(app: Starlette, *, ssl_certfile: str | None = None, ssl_keyfile: str | None = None) -> uvicorn.Config:
    """Uvicorn's settings for our application, within the limits of this process."""
    files = raise_file_limit()
    settings = app.state.manager.settings
    wanted = settings.connections + HTTP_CONNECTIONS
    guard = ConnectionGuard(max(16, min(wanted, files - SPARE_FILES)))
    log_less()
    return uvicorn.Config(
        app,
        http=guard.protocol,
        ws=GuardedWebSocket,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        ws_ping_interval=None,
        lifespan="on",
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=list(settings.proxies),
        timeout_graceful_shutdown=5,
        ssl_certfile=ssl_certfile,
        ssl_keyfile=ssl_keyfile,
    )
