"""The process: uvicorn with our limits, and an end that lets people finish."""

import asyncio
import socket
from collections.abc import Callable

import uvicorn
from starlette.applications import Starlette

from ..errors import EchoAvatarError
from ..wire import MAX_MESSAGE_BYTES


class Server(uvicorn.Server):
    """Drains the manager before the connections are closed; a second signal ends it at once."""

    def __init__(self, app: Starlette, config: uvicorn.Config, on_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._app, self._on_ready = app, on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen, and say so."""
        await super().startup(sockets)
        if self.started:
            self._on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain, then close."""
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
    """Serve until SIGINT or SIGTERM; port 0 takes any free one. `on_ready` is told the address.

    Raises:
        EchoAvatarError: the port is taken, or not ours to take.
    """
    listener = listen(host, port)
    name = f"[{host}]" if ":" in host else host
    address = f"{'https' if ssl_certfile else 'http'}://{name}:{listener.getsockname()[1]}"
    config = configure(app, ssl_certfile=ssl_certfile, ssl_keyfile=ssl_keyfile)
    with listener:
        Server(app, config, lambda: on_ready(address) if on_ready else None).run(sockets=[listener])


def configure(
    app: Starlette, *, ssl_certfile: str | None = None, ssl_keyfile: str | None = None
) -> uvicorn.Config:
    """Our limits."""
    return uvicorn.Config(
        app,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        ws_ping_interval=None,
        lifespan="on",
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=5,
        ssl_certfile=ssl_certfile,
        ssl_keyfile=ssl_keyfile,
    )


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; port 0 takes any free one.

    Raises:
        EchoAvatarError: the port is taken, or not ours to take.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
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
