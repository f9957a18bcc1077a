"""Clients that misbehave beside an honest one (`echoavatar bench neighbours`), each until its process is ended."""

import asyncio
import os
import secrets
import socket
import ssl
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect as dial

from echoavatar import outgoing
from echoavatar.agents.client import stream_url
from echoavatar.wire.codec import encode, subprotocol
from echoavatar.wire.messages import Action, Hello, Ping, Played

CANDIDATES = 900
IDLE_SOCKETS, HANDSHAKES = 1_100, 400
REPORTS_HZ = 30


class Target(NamedTuple):
    """What a neighbour needs to know."""

    address: str  # http or https
    token: str
    session: str
    certificate: str  # PEM, to be trusted; empty: none
    offer: str  # SDP


def nobody(_: Target) -> None:
    """Nothing."""
    time.sleep(1e6)


def offers(target: Target) -> None:
    """Post a WHEP offer, delete the viewer, and again."""
    key = {"authorization": f"Bearer {target.token}"}
    while True:
        with suppress(OSError, HTTPException):
            way = _http(target)
            while True:
                way.request("POST", "/v1/whep", target.offer, {**key, "content-type": "application/sdp"})
                answer = way.getresponse()
                answer.read()
                if answer.status == 201:
                    way.request("DELETE", answer.headers["location"], headers=key)
                    way.getresponse().read()


def offers_of_candidates(target: Target) -> None:
    """The same with 900 addresses in each offer."""
    offers(with_candidates(target, lambda number: f"10.{number >> 8}.{number & 255}.7"))


def offers_of_names(target: Target) -> None:
    """The same with 900 names of mDNS."""
    offers(with_candidates(target, lambda number: f"{secrets.token_hex(4)}-{number}.local"))


def guesses(target: Target) -> None:
    """Guess tokens: over HTTP on one socket, and in the hello of one WebSocket after the other."""
    threading.Thread(target=_guess_in_hello, args=(target,), daemon=True).start()
    _ask(target, "/v1/tools", lambda: {"authorization": f"Bearer {secrets.token_hex(4)}"})


def _guess_in_hello(target: Target) -> None:
    while True:
        with suppress(OSError, WebSocketException), _socket(target) as line:
            line.send(encode(Hello(token=secrets.token_hex(4))))
            while True:
                line.recv()


def reports(target: Target) -> None:
    """Watch the speaker's session, and report thirty times a second that nothing was played."""
    while True:
        with suppress(OSError, WebSocketException), _socket(target) as line:
            line.send(encode(Hello(role="viewer", session=target.session, token=target.token, want=())))
            while True:
                line.send(encode(Played(at=0, epoch=0)))
                time.sleep(1 / REPORTS_HZ)


def pings(target: Target) -> None:
    """Watch the speaker's session, and send pings as fast as the server reads them."""
    _flood(target, encode(Ping()))


def actions(target: Target) -> None:
    """Watch the speaker's session, and ask for unknown actions as fast as the server reads them."""
    _flood(target, encode(Action(id="x", name="unknown")))


def _flood(target: Target, message: bytes) -> None:
    while True:
        with suppress(OSError, WebSocketException), _socket(target) as line:
            line.send(encode(Hello(role="viewer", session=target.session, token=target.token, want=())))
            threading.Thread(target=_drain, args=(line,), daemon=True).start()
            while True:
                line.send(message)


def visitors(target: Target) -> None:
    """Open a session and go, and again."""
    while True:
        with suppress(OSError, WebSocketException), _socket(target) as line:
            line.send(encode(Hello(token=target.token)))
            line.recv()


def requests(target: Target) -> None:
    """Ask for the server's health over eight sockets."""
    for _ in range(7):
        threading.Thread(target=_ask, args=(target, "/health"), daemon=True).start()
    _ask(target, "/health")


def _ask(target: Target, path: str, headers: Callable[[], dict[str, str]] = dict) -> None:
    """Ask again and again on one socket, with new headers each time."""
    while True:
        with suppress(OSError, HTTPException):
            way = _http(target)
            while True:
                way.request("GET", path, headers=headers())
                way.getresponse().read()


def idle(target: Target) -> None:
    """1,100 sockets that say nothing; each is opened again once it is closed."""
    _hold(target, IDLE_SOCKETS, b"")


def handshakes(target: Target) -> None:
    """400 TLS handshakes that stop after the first bytes; each is begun again once it is closed."""
    _hold(target, HANDSHAKES, bytes([22, 3, 1, 2, 0, 1, 0, 1, 252]))


def viewers(target: Target) -> None:
    """A viewer on each renderer of the server, for as long as it lasts."""
    asyncio.run(_watch(target, viewers_of(target)))


def viewers_of(target: Target) -> int:
    """How many viewers the server draws for at once; 0 if it shows no video."""
    return int(outgoing.ask(f"{target.address}/health").get("video", {}).get("viewers", 0))


async def _watch(target: Target, count: int) -> None:
    from aiortc import RTCSessionDescription

    peers = [_peer() for _ in range(count)]
    for peer in peers:
        await peer.setLocalDescription(await peer.createOffer())
        way = _http(target)
        headers = {"authorization": f"Bearer {target.token}", "content-type": "application/sdp"}
        way.request("POST", "/v1/whep", peer.localDescription.sdp, headers)
        answer = await asyncio.to_thread(way.getresponse)
        await peer.setRemoteDescription(RTCSessionDescription(answer.read().decode(), "answer"))
    await asyncio.sleep(1e6)


NEIGHBOURS: dict[str, Callable[[Target], None]] = {
    "nobody": nobody,
    "offers": offers,
    "offers of 900 addresses": offers_of_candidates,
    "offers of 900 .local names": offers_of_names,
    "token guesses": guesses,
    "played at 0": reports,
    "pings": pings,
    "actions": actions,
    "visitors": visitors,
    "requests": requests,
    "idle sockets": idle,
    "viewers that stay": viewers,
    "stalled TLS handshakes": handshakes,
}
WITH_VIDEO = ("offers", "offers of 900 addresses", "offers of 900 .local names", "viewers that stay")
WITH_TLS = ("stalled TLS handshakes",)


def _http(target: Target) -> HTTPConnection:
    parts = urlsplit(target.address)
    if parts.scheme == "http":
        return HTTPConnection(parts.netloc, timeout=60)
    return HTTPSConnection(parts.netloc, timeout=60, context=ssl.create_default_context(cafile=target.certificate))


def _socket(target: Target) -> Any:
    trust = ssl.create_default_context(cafile=target.certificate) if target.address.startswith("https") else None
    protocols: Any = [subprotocol("msgpack")]
    url = stream_url(target.address)
    return dial(url, subprotocols=protocols, compression=None, ssl=trust, proxy=outgoing.proxy_for(url))


def _drain(line: Any) -> None:
    with suppress(OSError, WebSocketException):
        while True:
            line.recv()


def _hold(target: Target, count: int, first: bytes) -> None:
    """Keep sockets open that send `first` and no more."""
    place = urlsplit(target.address)
    held = [_begin(place.hostname, place.port, first) for _ in range(count)]
    while True:
        for number, line in enumerate(held):
            with suppress(BlockingIOError):
                if line.recv(64) == b"":
                    line.close()
                    held[number] = _begin(place.hostname, place.port, first)
        time.sleep(0.2)


def _begin(host: str | None, port: int | None, first: bytes) -> socket.socket:
    line = socket.create_connection((host, port), timeout=30)
    line.sendall(first)
    line.setblocking(False)
    return line


def with_candidates(target: Target, host: Callable[[int], str]) -> Target:
    """The target with 900 candidates more in its offer; `host` names them by their numbers."""
    found = "".join(
        f"a=candidate:{number} 1 udp {2_130_706_431 - number} {host(number)} {20_000 + number} typ host\r\n"
        for number in range(CANDIDATES)
    )
    head, mark, rest = target.offer.partition("a=candidate:")
    return target._replace(offer=head + found + mark + rest)


def attack(name: str, target: Target) -> None:
    """Be a neighbour, at the lowest priority."""
    os.nice(19)
    NEIGHBOURS[name](target)


def make_offer() -> str:
    """An SDP offer as a player makes it; empty without aiortc."""

    async def make() -> str:
        peer = _peer()
        await peer.setLocalDescription(await peer.createOffer())
        text = str(peer.localDescription.sdp)
        await peer.close()
        return text

    try:
        return asyncio.run(make())
    except ImportError:
        return ""


def _peer() -> Any:
    from aiortc import RTCConfiguration, RTCPeerConnection

    peer = RTCPeerConnection(RTCConfiguration(iceServers=[]))
    for kind in ("video", "audio"):
        peer.addTransceiver(kind, direction="recvonly")
    return peer
