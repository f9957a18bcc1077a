"""How often a client may ask for costly things. Requests beyond a rate wait or are refused; see `ClientLimits`.

A client is an IPv4 address or the first 64 bits of an IPv6 one, so an office behind one address is one client.
"""

import asyncio
import math
from dataclasses import dataclass
from typing import Any, Literal

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from echoavatar.wire.guard import network_of
from echoavatar.wire.rates import Limiter, Rate, TokenGate, too_often

PATIENCE_S = 2.0  # a request that would have to wait for longer is refused
REFUSAL_S = 1.0  # delay of the answer to an offer or a call that comes too often
Kind = Literal["requests", "offers", "hellos", "commands", "reports", "sounds"]


@dataclass(frozen=True)
class ClientRates:
    """The rates of one client."""

    requests: Rate = Rate(150, 1_800)  # HTTP requests and new WebSockets
    offers: Rate = Rate(4, 30)  # new WebRTC viewers
    hellos: Rate = Rate(30, 300)  # sessions that are opened, resumed or watched
    commands: Rate = Rate(60, 600)  # action, manner, music, interrupt, and calls of tools
    reports: Rate = Rate(600, 18_000)  # played, ping
    sounds: Rate = Rate(1_000, 30_000)  # audio, words and end, of one connection


class ClientLimits:
    """The buckets of all clients of a server.

    Messages of a WebSocket wait: while they do, nothing more is read from it, nothing is lost, and only the sender
    notices. Requests of HTTP wait for a moment and are then refused, because waiting sockets take places of others.
    """

    def __init__(self, rates: ClientRates, token: str) -> None:
        self.gate = TokenGate(token)
        self._rates, self._limiter = rates, Limiter()

    async def pace(self, kind: Kind, key: str) -> None:
        """Count a message of a client, and wait until its turn."""
        if seconds := self._wait(kind, key, patience=math.inf):
            await asyncio.sleep(seconds)

    async def check(self, kind: Kind, key: str) -> None:
        """Count a request of a client. A refusal is slow, so that asking again and again costs the server little.

        Raises ProtocolError: `overloaded`, with `retry_after`.
        """
        if seconds := self._wait(kind, key):
            await asyncio.sleep(REFUSAL_S)
            raise too_often(f"too many {kind} came from this address", seconds)

    async def hold(self, key: str) -> float:
        """Hold an HTTP request until its turn and return 0; or, if refused, the seconds until it may come again."""
        seconds = self._wait("requests", key, patience=PATIENCE_S)
        if seconds > PATIENCE_S:
            return seconds
        await asyncio.sleep(seconds)
        return 0.0

    def _wait(self, kind: Kind, key: str, *, patience: float = 0.0) -> float:
        return self._limiter.wait(f"{kind} {key}", getattr(self._rates, kind), patience=patience)


def client_of(scope: Any) -> str:
    """The client of a request or a WebSocket with this ASGI scope."""
    return network_of(scope["client"][0]) if scope.get("client") else ""


class RequestPace:
    """Holds or refuses requests and WebSockets of clients that send too many."""

    def __init__(self, app: ASGIApp, limits: ClientLimits) -> None:
        self._app, self._limits = app, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, later, or answer 429."""
        seconds = 0.0 if scope["type"] == "lifespan" else await self._limits.hold(client_of(scope))
        if not seconds:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1013})
        else:
            answer = refusal(str(too_often("too many requests came from this address", seconds)), 429, seconds=seconds)
            await answer(scope, receive, send)


def refusal(reason: str, status: int, *, seconds: float = 0.0) -> JSONResponse:
    """An answer that says why, and after how many seconds to try again unless they are 0."""
    return JSONResponse({"error": reason}, status, {"retry-after": str(math.ceil(seconds))} if seconds else None)
