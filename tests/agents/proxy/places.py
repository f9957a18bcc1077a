"""A scripted voice agent, an avatar server with a minimal pipeline and a face, and a proxy between them."""

import asyncio
import contextlib
import http.client
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import tests.server.fakes as fakes
from tests.agents.proxy.scripted import Script, ScriptedSession, ScriptedUpstream
from tests.server.fakes import Body, RunningServer, serving
from websockets.asyncio.client import ClientConnection, connect

from echoavatar.agents.client.connection import quiet_logger
from echoavatar.agents.proxy import ProxySettings, Relay


class FacedBody(Body):
    """The left eye closes as the hips rise."""

    face = "a face"

    def step(self, *given: Any) -> Any:
        return [
            chunk._replace(face=np.clip(np.tile(chunk.root[:, 1:2], (1, 52)), 0, 1)) for chunk in super().step(*given)
        ]


@contextlib.contextmanager
def avatar_server(**options: Any) -> Iterator[RunningServer]:
    """An avatar server."""
    with patch.object(fakes, "Body", FacedBody), serving(**options) as server:
        yield server


@contextlib.asynccontextmanager
async def proxied(
    script: Script, avatar: str = "", *, settings: ProxySettings | None = None, **options: Any
) -> AsyncIterator[tuple[str, ScriptedUpstream, Relay]]:
    """Run a proxy in front of a scripted upstream; yields the proxy's address first."""
    async with ScriptedUpstream(script, **options) as upstream:
        given = settings or ProxySettings("ws://nowhere.example")
        relay = Relay(replace(given, upstream=upstream.url, avatar=avatar))
        port = await relay.start(port=0)
        try:
            yield f"ws://127.0.0.1:{port}/v1/realtime", upstream, relay
        finally:
            await relay.stop()


class Listener:
    """A client that records everything: what the upstream sent as text, what the proxy added as events."""

    def __init__(self, websocket: ClientConnection) -> None:
        self.websocket = websocket
        self.passed: list[str] = []
        self.added: list[dict[str, Any]] = []
        self.code: int | None = None

    async def listen(self, until: Callable[["Listener"], bool] = lambda _: False, seconds: float = 15) -> None:
        from websockets.exceptions import ConnectionClosed

        async with asyncio.timeout(seconds):
            while not until(self):
                try:
                    text = await self.websocket.recv()
                except ConnectionClosed as closed:
                    self.code = closed.rcvd.code if closed.rcvd else 1006
                    return
                if isinstance(text, str) and '"echoavatar_' in text[:120]:
                    self.added.append(json.loads(text))
                else:
                    self.passed.append(text)  # type: ignore[arg-type]

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [event for event in self.added if event["type"] == kind]

    async def say(self, kind: str, **fields: Any) -> None:
        await self.websocket.send(json.dumps({"type": kind, **fields}))


@contextlib.asynccontextmanager
async def listening(url: str, **options: Any) -> AsyncIterator[Listener]:
    # what the test did not read may keep the farewell back
    async with connect(url, compression=None, logger=quiet_logger(), close_timeout=1.0, **options) as websocket:
        yield Listener(websocket)


@contextlib.asynccontextmanager
async def talking(
    script: Script, *, pipeline: Any = None, settings: ProxySettings | None = None
) -> AsyncIterator[tuple[Listener, ScriptedUpstream, RunningServer]]:
    """A client that talks with a scripted upstream through a proxy with an avatar."""
    with avatar_server(pipeline=pipeline) as server:
        async with proxied(script, server.address, settings=settings) as (url, upstream, _), listening(url) as client:
            yield client, upstream, server


def tone(seconds: float, level: int = 8_000) -> bytes:
    """Constant sound, so that sums show how much was heard."""
    return np.full(round(24_000 * seconds), level, "<i2").tobytes()


async def silent(session: ScriptedSession) -> None:
    """A script that sends nothing."""


def run(what: Callable[[], Awaitable[None]], seconds: float = 30) -> None:
    asyncio.run(asyncio.wait_for(what(), seconds))  # type: ignore[arg-type]


def health(port: int) -> Any:
    """What a relay says of itself."""
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    line.request("GET", "/health")
    return json.load(line.getresponse())
