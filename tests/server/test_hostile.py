"""Crowds and noise at the door: ten thousand connects, and any bytes at all, while someone is being served."""

import asyncio
import base64
import contextlib
import dataclasses
import logging
import multiprocessing
import os
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.server.fakes import FAST, Caller, RunningServer, serving
from websockets.exceptions import ConnectionClosed

from echoavatar.server.clients import ClientRates
from echoavatar.wire.codec import encode
from echoavatar.wire.messages import Hello, Motion, Ping, Pong, Sound, Stats
from echoavatar.wire.rates import Rate

_log = logging.getLogger(__name__)
AT_ONCE = 100
MANNERS = ("hangs up at once", "hangs up when let in", "says hello and goes", "says nonsense", "says nothing of HTTP")


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    many = ClientRates(requests=Rate(1e6, 1e6), hellos=Rate(1e6, 1e6))  # a crowd has many addresses
    patient = dataclasses.replace(FAST, hello_seconds=1.0, resume_seconds=0.3, rates=many)
    with serving(seats=4, settings=patient) as server:
        yield server


@pytest.fixture
def neighbour(server: RunningServer) -> Iterator[Caller]:
    """Somebody who is served all the while."""
    with server.call(Hello(seed=9)) as caller:
        caller.until(Motion)
        yield caller


def is_served(caller: Caller) -> None:
    """Motion goes on, without a hole."""
    caller.say(Ping(nonce=4))
    caller.until(Pong, lambda pong: pong.nonce == 4)
    at = caller.until(Motion).at
    caller.until(Motion, lambda motion: motion.at > at)
    sounds = [message.at for message in caller.heard if isinstance(message, Sound)]
    assert np.all(np.diff(sounds) == 6_400)


def masked(content: bytes) -> bytes:
    """A whole binary frame, as a client sends it; the mask is zero."""
    size = len(content)
    length = bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + size.to_bytes(2)
    return b"\x82" + length + bytes(4) + content


async def connect_once(host: str, port: int, number: int) -> str:
    """One connect, whose manners are its number's; what came of it."""
    manner = MANNERS[number % len(MANNERS)]
    try:
        reader, writer = await asyncio.open_connection(host, port)
    except OSError:
        return "not let in"
    with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.TimeoutError):
        async with asyncio.timeout(20):
            if manner == "says nothing of HTTP":
                writer.write(os.urandom(64) + b"\r\n\r\n")
                await reader.read(200)
            elif manner != "hangs up at once":
                key = base64.b64encode(os.urandom(16)).decode()
                writer.write(
                    f"GET /v1/stream HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                    f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
                    "Sec-WebSocket-Protocol: echoavatar.v1.msgpack\r\n\r\n".encode()
                )
                answer = await reader.readuntil(b"\r\n\r\n")
                if not answer.startswith(b"HTTP/1.1 101"):
                    manner = "refused at the door"
                elif manner == "says hello and goes":
                    writer.write(masked(encode(Hello(seed=number))))
                    await reader.read(100)
                elif manner == "says nonsense":
                    writer.write(masked(os.urandom(40)))
                    await reader.read(1_000)
    writer.transport.abort()
    return manner


def crowd(address: str, connects: int) -> Counter[str]:
    """What came of so many connects."""
    return asyncio.run(_crowd(*address.split(":"), connects))


async def _crowd(host: str, port: str, connects: int) -> Counter[str]:
    turn = asyncio.Semaphore(AT_ONCE)

    async def one(number: int) -> str:
        async with turn:
            return await connect_once(host, int(port), number)

    return Counter(await asyncio.gather(*(one(number) for number in range(connects))))


@contextlib.contextmanager
def attended(caller: Caller) -> Iterator[None]:
    """The caller reads on meanwhile, and now and then says that it is there."""
    is_over = threading.Event()

    def read() -> None:
        while not is_over.is_set():
            if isinstance(caller.next(), Stats):  # once a second
                caller.say(Ping())

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield
    finally:
        is_over.set()
        reader.join()


@pytest.mark.parametrize("connects", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_many_connections_harm_no_session(server: RunningServer, neighbour: Caller, connects: int) -> None:
    """Nobody is left behind: connections, seats, sessions and file handles are as before."""
    handles = len(os.listdir("/proc/self/fd"))
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawned) as elsewhere:  # in this process, it would take its turns from the server
        elsewhere.submit(os.getpid).result()
        began, at = time.monotonic(), neighbour.until(Motion).at
        with attended(neighbour):
            seen = elsewhere.submit(crowd, server.address, connects).result()
    took = time.monotonic() - began
    _log.info("%d connects in %.1f s: %s", connects, took, dict(seen))
    assert seen["not let in"] == 0
    assert seen["says hello and goes"] > 0
    assert seen["says nonsense"] > 0
    is_served(neighbour)
    made = neighbour.until(Motion).at - at
    assert made / 24_000 > 0.9 * took - 1
    end = time.monotonic() + 20
    while (server.manager.sessions, server.manager.connections) != (1, 1) and time.monotonic() < end:
        time.sleep(0.05)
    assert (server.manager.sessions, server.manager.connections) == (1, 1)
    assert server.manager.engine.free == 3
    assert len(os.listdir("/proc/self/fd")) <= handles + 8
    with server.call(Hello()) as newcomer:
        newcomer.until(Motion)


frames = st.one_of(
    st.binary(max_size=200),
    st.text(max_size=100),
    st.recursive(
        st.none() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=8) | st.binary(max_size=8),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
        max_leaves=8,
    ).map(msgspec.msgpack.encode),
    st.sampled_from([encode(Hello()), encode(Ping())]).flatmap(
        lambda good: st.integers(0, len(good)).map(lambda cut: good[:cut])
    ),
)


@pytest.mark.parametrize("is_inside", [False, True], ids=["before the hello", "after it"])
def test_any_bytes_end_in_a_typed_error_and_a_close_code(
    server: RunningServer, neighbour: Caller, is_inside: bool
) -> None:
    @settings(max_examples=40, deadline=None)
    @given(frame=frames)
    @example(frame=b"")
    def bother(frame: bytes | str) -> None:
        with server.call(Hello() if is_inside else None) as caller:
            with contextlib.suppress(ConnectionClosed):
                caller.line.send(frame)
                caller.line.send(b"\xc1")  # never a message: whatever came before, this ends it
            code, error = caller.closing()
        assert 4400 <= code < 4500
        assert error is not None

    bother()
    is_served(neighbour)
