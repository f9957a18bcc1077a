"""Runs the studio: opens the folder and the store, and serves until it is stopped."""

import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn
from sqlalchemy import select
from starlette.applications import Starlette

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.guard import check_certificate
from echoavatar.wire.sockets import SPARE_FILES, ConnectionGuard, hurry_handshakes, listen, log_less, raise_file_limit

from .audit import note
from .store import Store, sqlite_url
from .tables import Study

CONNECTIONS = 4_096  # a browser opens six


def open_store(folder: Path, url: str | None) -> Store:
    """Open the store in a studio's folder, or at another address.

    Raises:
        EchoAvatarError: the folder cannot be written, or the store cannot be opened.
    """
    try:
        for name in ("media", "library"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchoAvatarError(f"cannot write to {folder}: {error.strerror}; choose another --folder") from error
    return Store(url or sqlite_url(folder / "studio.db"))


def mark_broken(store: Store) -> None:
    """Mark studies as failed that were being made when the studio stopped."""
    with store.write() as session:
        for study in session.scalars(select(Study).where(Study.state == "making")).all():
            study.state, study.problem = ("failed", "the studio was stopped while making it; delete it and begin again")
            note(session, "studio", "study failed", study=study.public, detail="stopped while making")


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, on_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        if self.config.ssl is not None:
            hurry_handshakes()
        await super().startup(sockets)
        if self.started:
            self._on_ready()


def serve(
    app: Starlette,
    *,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
    certificate: str | None = None,
    key: str | None = None,
    proxies: tuple[str, ...] = (),
) -> None:
    """Serve until SIGINT or SIGTERM. Port 0 takes any free port. `on_ready` is called with the address.

    `X-Forwarded-For` and `X-Forwarded-Proto` are believed from `proxies` (addresses or networks) and from nobody else.

    Raises:
        EchoAvatarError: the port is taken or needs privileges, or the certificate or its key cannot be used.
    """
    if certificate:
        check_certificate(certificate, key)
    places = min(CONNECTIONS, raise_file_limit() - SPARE_FILES)
    log_less()
    listener = listen(host, port)
    name = f"[{host}]" if ":" in host else host
    address = f"{'https' if certificate else 'http'}://{name}:{listener.getsockname()[1]}"
    config = uvicorn.Config(
        app,
        http=ConnectionGuard(max(16, places)).protocol,
        ws="none",
        lifespan="off",
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=bool(proxies),
        forwarded_allow_ips=list(proxies),
        timeout_graceful_shutdown=5,
        timeout_keep_alive=20,
        h11_max_incomplete_event_size=1 << 15,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    with listener:
        _Server(config, lambda: on_ready(address)).run(sockets=[listener])
