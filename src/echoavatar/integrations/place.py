"""Where an avatar lives: a server at an address, or an engine in this process. Both speak the same protocol."""

import asyncio
import contextlib
import json
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit, urlunsplit

from ..client import Avatar, Line, stream_url
from ..client.connection import ConnectionLostError
from ..engine import Engine, load
from ..errors import EchoAvatarError
from ..server import ServerSettings, create_app
from ..server.run import Server, configure, listen
from ..wire import Hello
from .line import MemoryLine

Schema = dict[str, Any]
PATIENCE_S = 10.0


class Place(Protocol):
    """Somewhere sessions can be had."""

    async def open(self, hello: Hello) -> Avatar:
        """A session.

        Raises:
            ConnectionLostError: nobody answers there.
            ProtocolError: wrong token, no free seat.
        """

    async def tools(self) -> list[Schema]:
        """What a language model may do there: name, description, parameters of each tool."""

    def page(self, session: str) -> str:
        """Address of the page that shows a session; empty where there is none."""

    async def close(self) -> None:
        """Nobody wants anything any more."""


def find_place(where: "str | Path | Engine", *, token: str = "", port: int | None = None) -> Place:
    """A server's address such as `http://127.0.0.1:8765`; or an engine, a bundle's name or folder, to run here.

    `port` opens a door for pages to an engine that runs here: on this machine only, 0 takes any free port.
    """
    if isinstance(where, str) and "://" in where:
        return Remote(where, token)
    return Local(where, port=port)


class Remote:
    """A server."""

    def __init__(self, url: str, token: str) -> None:
        self._url, self._token = stream_url(url), token

    async def open(self, hello: Hello) -> Avatar:
        """A session there."""
        avatar = Avatar(self._url, _with_token(hello, self._token))
        await avatar.open()
        return avatar

    async def tools(self) -> list[Schema]:
        """As the server declares them.

        Raises:
            ConnectionLostError: it does not.
        """
        request = urllib.request.Request(self._http("/v1/tools"))
        if self._token:
            request.add_header("Authorization", f"Bearer {self._token}")
        try:
            found: list[Schema] = json.loads(await asyncio.to_thread(_read, request))
        except (OSError, ValueError) as error:
            raise ConnectionLostError(
                f"{request.full_url} does not tell its tools ({error}); is the token right?"
            ) from error
        return found

    def page(self, session: str) -> str:
        """Its page."""
        key = f"#token={self._token}" if self._token else ""
        return f"{self._http('/')}?watch={session}{key}"

    async def close(self) -> None:
        """Nothing is ours there."""

    def _http(self, path: str) -> str:
        parts = urlsplit(self._url)
        return urlunsplit(({"ws": "http", "wss": "https"}[parts.scheme], parts.netloc, path, "", ""))


class Local:
    """An engine in this process, behind the same application that a server runs; it starts with the first session."""

    def __init__(self, where: "str | Path | Engine", *, port: int | None = None) -> None:
        self._where, self._port = where, port
        self._app: Any = None
        self._address = ""
        self._life: asyncio.Task[None] | None = None
        self._begun, self._over = asyncio.Event(), asyncio.Event()

    async def open(self, hello: Hello) -> Avatar:
        """A session here; loads the model first, which takes a while."""
        await self._begin()
        avatar = Avatar("this process", hello, self._dial)
        await avatar.open()
        return avatar

    async def tools(self) -> list[Schema]:
        """Of the bundle's actions and our music."""
        await self._begin()
        schemas: list[Schema] = self._app.state.manager.toolbox.schemas()
        return schemas

    def page(self, session: str) -> str:
        """The page behind our own door, if there is one."""
        return f"{self._address}/?watch={session}" if self._address else ""

    async def close(self) -> None:
        """Stop the engine."""
        self._over.set()
        if self._life is not None:
            await asyncio.wait([self._life])

    async def _dial(self) -> Line:
        return MemoryLine(self._app)

    async def _begin(self) -> None:
        if self._life is None:
            self._life = asyncio.ensure_future(self._live())
        waiting = asyncio.ensure_future(self._begun.wait())
        await asyncio.wait([waiting, self._life], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if self._life.done():
            self._life.result()  # raises what went wrong
            raise EchoAvatarError("this engine was closed; open another")

    async def _live(self) -> None:
        """One task owns the application's whole life, because task groups must end where they began."""
        engine = (
            self._where if isinstance(self._where, Engine) else await asyncio.to_thread(load, self._where)
        )
        self._app = create_app(engine, ServerSettings(resume_seconds=1.0))
        async with self._app.router.lifespan_context(self._app):
            if self._port is None:
                self._begun.set()
                await self._over.wait()
                return
            with listen("127.0.0.1", self._port) as listener:
                self._address = f"http://127.0.0.1:{listener.getsockname()[1]}"
                config = configure(self._app)
                config.lifespan = "off"  # it runs already
                door = _Door(self._app, config, self._begun.set)
                serving = asyncio.ensure_future(door.serve(sockets=[listener]))
                await self._over.wait()
                door.should_exit = door.force_exit = True
                await serving


class _Door(Server):
    """The server beside an application of the user's: signals are the user's business."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _with_token(hello: Hello, token: str) -> Hello:
    import msgspec

    return msgspec.structs.replace(hello, token=token)


def _read(request: urllib.request.Request) -> bytes:
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:  # the scheme is http or https
        content: bytes = answer.read()
        return content
