"""Where an avatar runs: on a server, or on an engine in this process, which is served to this process alone."""

import asyncio
import contextlib
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from echoavatar.agents.client import Avatar, RemoteTools, stream_url
from echoavatar.engine import Engine, load
from echoavatar.engine.tools import Schema
from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, create_app
from echoavatar.server.run import Server
from echoavatar.wire.messages import Hello


def find_backend(where: "str | Path | Engine", *, token: str = "", port: int | None = None) -> "AvatarBackend":
    """The backend at `where`: a server's address such as `http://127.0.0.1:8765`, or an engine, bundle name or folder.

    An engine or bundle runs in this process. `port` then serves its page, on this machine only; 0 takes any free port.
    EchoAvatarError: the address is not valid.
    """
    if isinstance(where, str) and "://" in where:
        return AvatarBackend(stream_url(where), token)
    return LocalBackend(where, port=port)


class AvatarBackend:
    """An avatar server at an address."""

    def __init__(self, url: str, token: str) -> None:
        self._url, self._token = url, token

    async def open(self, hello: Hello) -> Avatar:
        """Open a session there; raises as `Avatar.open`."""
        avatar = Avatar(stream_url(await self._reach()), msgspec.structs.replace(hello, token=self._token))
        await avatar.open()
        return avatar

    async def tools(self) -> list[Schema]:
        """The tools that a language model may call there, see `RemoteTools.schemas`."""
        return await asyncio.to_thread(RemoteTools(await self._reach(), token=self._token).schemas)

    async def call(self, name: str, arguments: Mapping[str, Any], session: str) -> Schema:
        """Call one of them on a session, see `RemoteTools.call`."""
        return await RemoteTools(await self._reach(), token=self._token, session=session).call_async(name, arguments)

    def page(self, session: str) -> str:
        """Address of the server's page, which watches this session."""
        key = f"#token={self._token}" if self._token else ""
        return f"{RemoteTools(self._url).base}/?watch={session}{key}"

    async def close(self) -> None:
        """Nothing to release: the server is not ours."""

    async def _reach(self) -> str:
        """The server's address."""
        return self._url


class LocalBackend(AvatarBackend):
    """An engine in this process, behind a server that starts with the first session; to load the model takes a while.

    Without a port for its page, any free one is taken, and only this object knows the token.
    """

    def __init__(self, where: "str | Path | Engine", *, port: int | None = None) -> None:
        super().__init__("", secrets.token_urlsafe(16) if port is None else "")
        self._where, self._port = where, port
        self._app: Any = None
        self._running: asyncio.Task[None] | None = None
        self._started, self._stopped = asyncio.Event(), asyncio.Event()

    def page(self, session: str) -> str:
        """Address of the page if a port was given, else empty."""
        return "" if self._port is None or not self._url else super().page(session)

    async def close(self) -> None:
        """Stop the engine."""
        self._stopped.set()
        if self._running is not None:
            await asyncio.wait([self._running])

    async def _reach(self) -> str:
        if self._running is None:
            self._running = asyncio.ensure_future(self._run())
        waiting = asyncio.ensure_future(self._started.wait())
        await asyncio.wait([waiting, self._running], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if self._running.done() or not self._url:
            await self._running  # raises what went wrong
            raise EchoAvatarError("this engine was closed; open another")
        return self._url

    async def _run(self) -> None:
        """Run the application in one task, because a task group must end in the task that began it."""
        engine = self._where if isinstance(self._where, Engine) else await asyncio.to_thread(load, self._where)
        self._app = create_app(engine, ServerSettings(token=self._token, resume_seconds=1.0))
        async with self._app.router.lifespan_context(self._app):
            server = _LocalServer(self._app, port=self._port or 0, lifespan="off", on_ready=self._be_found)
            serving = asyncio.ensure_future(server.serve())
            await self._stopped.wait()
            server.should_exit = server.force_exit = True
            await serving

    def _be_found(self, address: str) -> None:
        self._url = address
        self._started.set()


class _LocalServer(Server):
    """Serves an engine in the user's program, so it leaves signals to that program."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield
