"""Where an avatar runs: on a server, or on an engine in this process. Both speak the same protocol.

In this process, `InProcessSocket` is a WebSocket to the server's ASGI application, without a network socket.
"""

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from starlette.types import ASGIApp, Message
from websockets.exceptions import ConnectionClosed, ConnectionClosedError, ConnectionClosedOK
from websockets.frames import Close

from echoavatar.agents.client import Avatar, MessageSocket, RemoteTools, stream_url
from echoavatar.engine import Engine, load
from echoavatar.engine.tools import Schema
from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, create_app
from echoavatar.server.run import Server
from echoavatar.wire.codec import subprotocol
from echoavatar.wire.messages import Hello

MAX_QUEUED_FRAMES = 1024  # messages for a reader that does not read


class InProcessSocket:
    """The client's side of one WebSocket connection to an ASGI application."""

    def __init__(self, app: ASGIApp) -> None:
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "path": "/v1/stream",
            "headers": [],
            "subprotocols": [subprotocol("msgpack")],
        }
        self._out: asyncio.Queue[Message] = asyncio.Queue()
        self._in: asyncio.Queue[Message] = asyncio.Queue(MAX_QUEUED_FRAMES)
        self._closed: ConnectionClosed | None = None
        self._out.put_nowait({"type": "websocket.connect"})
        self._serving = asyncio.ensure_future(self._serve(app, scope))

    async def send(self, message: bytes) -> None:
        """Send one frame to the application.

        Raises:
            ConnectionClosed: the application has closed the connection.
        """
        if self._closed is not None:
            raise self._closed
        await self._out.put({"type": "websocket.receive", "bytes": message})

    async def recv(self, *, decode: bool | None = None) -> bytes:
        """Receive the next frame from the application.

        Raises:
            ConnectionClosed: the application has closed the connection.
        """
        del decode  # frames are always bytes
        while self._closed is None or not self._in.empty():
            message = await self._in.get()
            if message["type"] == "websocket.send":
                frame: bytes = message["bytes"]
                return frame
            if message["type"] == "websocket.close" and self._closed is None:
                self._close(message.get("code", 1000), message.get("reason") or "")
        raise self._closed or ConnectionClosedOK(None, None)

    async def close(self) -> None:
        """Close the connection and wait until the application has ended."""
        if self._closed is None:
            self._close(1000, "")
        await self._out.put({"type": "websocket.disconnect", "code": 1000})
        while not self._serving.done():  # the application may be blocked on a frame that is never read
            while not self._in.empty():
                self._in.get_nowait()
            await asyncio.wait([self._serving], timeout=0.05)
        self._in.put_nowait({"type": "websocket.close"})  # wakes a pending `recv`

    def _close(self, code: int, reason: str) -> None:
        kind = ConnectionClosedOK if code in (1000, 1001) else ConnectionClosedError
        self._closed = kind(Close(code, reason), None)

    async def _serve(self, app: ASGIApp, scope: Message) -> None:
        try:
            await app(scope, self._out.get, self._in.put)
        finally:
            if self._in.full():  # room for the close message
                self._in.get_nowait()
            self._in.put_nowait({"type": "websocket.close", "code": 1006})


def find_backend(where: "str | Path | Engine", *, token: str = "", port: int | None = None) -> "AvatarBackend":
    """The backend at `where`: a server's address such as `http://127.0.0.1:8765`, or an engine, bundle name or folder.

    An engine or bundle runs in this process. `port` then serves its page, on this machine only; 0 takes any free port.
    """
    if isinstance(where, str) and "://" in where:
        return RemoteBackend(where, token)
    return LocalBackend(where, port=port)


class RemoteBackend:
    """A server."""

    def __init__(self, url: str, token: str) -> None:
        self._url, self._token = stream_url(url), token
        self._tools = RemoteTools(url, token=token)

    async def open(self, hello: Hello) -> Avatar:
        """Open a session there; raises as `Avatar.open`."""
        avatar = Avatar(self._url, msgspec.structs.replace(hello, token=self._token))
        await avatar.open()
        return avatar

    async def tools(self) -> list[Schema]:
        """The tools that a language model may call there, see `RemoteTools.schemas`."""
        return await asyncio.to_thread(self._tools.schemas)

    def page(self, session: str) -> str:
        """Address of the server's page."""
        key = f"#token={self._token}" if self._token else ""
        return f"{self._tools.base}/?watch={session}{key}"

    async def close(self) -> None:
        """Nothing to release: the server is not ours."""


class LocalBackend:
    """An engine in this process, behind the same application that a server runs. It starts with the first session."""

    def __init__(self, where: "str | Path | Engine", *, port: int | None = None) -> None:
        self._where, self._port = where, port
        self._app: Any = None
        self._address = ""
        self._running: asyncio.Task[None] | None = None
        self._started, self._stopped = asyncio.Event(), asyncio.Event()

    async def open(self, hello: Hello) -> Avatar:
        """Open a session here; the first one loads the model, which takes a while.

        Raises:
            ProtocolError: no seat is free.
        """
        await self._start()
        avatar = Avatar("this process", hello, self._dial)
        await avatar.open()
        return avatar

    async def tools(self) -> list[Schema]:
        """The tools for the bundle's actions and the built-in music."""
        await self._start()
        schemas: list[Schema] = self._app.state.manager.toolbox.schemas()
        return schemas

    def page(self, session: str) -> str:
        """Address of the page if a port was given, else empty."""
        return f"{self._address}/?watch={session}" if self._address else ""

    async def close(self) -> None:
        """Stop the engine."""
        self._stopped.set()
        if self._running is not None:
            await asyncio.wait([self._running])

    async def _dial(self) -> MessageSocket:
        return InProcessSocket(self._app)

    async def _start(self) -> None:
        if self._running is None:
            self._running = asyncio.ensure_future(self._run())
        waiting = asyncio.ensure_future(self._started.wait())
        await asyncio.wait([waiting, self._running], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if self._running.done():
            self._running.result()  # raises what went wrong
            raise EchoAvatarError("this engine was closed; open another")

    async def _run(self) -> None:
        """Run the application in one task, because a task group must end in the task that began it."""
        engine = self._where if isinstance(self._where, Engine) else await asyncio.to_thread(load, self._where)
        self._app = create_app(engine, ServerSettings(resume_seconds=1.0))
        async with self._app.router.lifespan_context(self._app):
            if self._port is None:
                self._started.set()
                await self._stopped.wait()
                return
            server = _PageServer(self._app, port=self._port, lifespan="off", on_ready=self._be_found)
            serving = asyncio.ensure_future(server.serve())
            await self._stopped.wait()
            server.should_exit = server.force_exit = True
            await serving

    def _be_found(self, address: str) -> None:
        self._address = address
        self._started.set()


AvatarBackend = RemoteBackend | LocalBackend


class _PageServer(Server):
    """Serves the page of an engine in the user's program, so it leaves signals to that program."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield
