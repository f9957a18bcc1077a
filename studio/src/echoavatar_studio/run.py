"""Runs the studio: opens the folder and the store, and serves until it is stopped."""

from collections.abc import Callable
from pathlib import Path

from sqlalchemy import select
from starlette.applications import Starlette

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.sockets import WebServer

from .audit import note
from .store import Store, sqlite_url
from .tables import Study


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


def serve(
    app: Starlette,
    *,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
    certificate: str | None = None,
    key: str | None = None,
    proxies: tuple[str, ...] = (),
    origins: tuple[str, ...] = (),
) -> None:
    """Serve until SIGINT or SIGTERM. Port 0 takes any free port. `on_ready` is called with the address.

    `X-Forwarded-For` and `X-Forwarded-Proto` are believed from `proxies` (addresses or networks) and from nobody else.
    Requests may name the studio by a host of `origins`; by any host with a certificate, which says whose it is.

    Raises:
        EchoAvatarError: the port is taken or needs privileges, or the certificate or its key cannot be used.
    """
    server = WebServer(
        app,
        host=host,
        port=port,
        names=None if certificate else origins,
        on_ready=on_ready,
        certificate=certificate,
        key=key,
        proxies=proxies,
        ws="none",
        lifespan="off",
        timeout_keep_alive=20,
        h11_max_incomplete_event_size=1 << 15,
    )
    server.run()
