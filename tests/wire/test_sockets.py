"""Sockets of strangers: they may be many, silent, or never come to an end; a client is served all the same."""

import contextlib
import logging
import socket
import time
from collections.abc import Iterator

import pytest
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar.errors import EchoAvatarError
from echoavatar.wire import sockets
from echoavatar.wire.messages import Hello, Motion
from echoavatar.wire.sockets import ConnectionGuard, RepeatFilter, listen, raise_file_limit

LIMIT = 40


def address(server: RunningServer) -> tuple[str, int]:
    host, port = server.address.split(":")
    return host, int(port)


@contextlib.contextmanager
def small(monkeypatch: pytest.MonkeyPatch, *, limit: int = LIMIT, silence_s: float = 10.0) -> Iterator[RunningServer]:
    """A server with few places, or little patience."""
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda _: ConnectionGuard(limit, silence_s=silence_s))
    with serving(settings=FAST) as server:
        yield server


def is_closed(line: socket.socket) -> bool:
    line.settimeout(5)
    with contextlib.suppress(ConnectionResetError):
        return line.recv(100) == b""
    return True


def test_idle_sockets_lock_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times as many silent sockets as there are places; a client is served, and the oldest are closed."""
    with small(monkeypatch) as server, contextlib.ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(address(server))) for _ in range(3 * LIMIT)]
        with server.call(Hello()) as caller:
            caller.until(Motion)
        assert is_closed(idle[0])
        assert len(server.uvicorn.server_state.connections) <= LIMIT


def test_a_silent_socket_is_closed_and_so_is_a_request_that_never_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    with small(monkeypatch, silence_s=0.3) as server, contextlib.ExitStack() as stack:
        silent, slow = (stack.enter_context(socket.create_connection(address(server))) for _ in range(2))
        slow.sendall(b"GET /health HTTP/1.1\r\n")
        with server.call(Hello()) as caller:
            assert is_closed(silent)
            assert is_closed(slow)
            time.sleep(0.7)
            caller.until(Motion)  # a WebSocket is no silent socket


def test_the_file_limit_is_raised_where_it_may_be() -> None:
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, before[1]))
        raised = raise_file_limit(512)
        assert raised == resource.getrlimit(resource.RLIMIT_NOFILE)[0] == min(512, before[1])
        assert raise_file_limit(100) == raised
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_repeated_line_is_logged_once_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(sockets.time, "monotonic", lambda: now)
    limiter = RepeatFilter()

    def is_logged(text: str) -> bool:
        return limiter.filter(logging.LogRecord("asyncio", logging.ERROR, "", 0, text, None, None))

    assert [is_logged("out of files"), is_logged("out of files"), is_logged("another")] == [True, False, True]
    now += 11
    assert is_logged("out of files")


TRAILERS = b"POST /v1/chat HTTP/1.1\r\ntransfer-encoding: chunked\r\n\r\n0\r\n"


@pytest.mark.parametrize("piece", [b"x: 1\r\n" * 2_000, b"x" * 16_000], ids=["many headers", "one long header"])
@pytest.mark.parametrize("start", [b"GET / HTTP/1.1\r\n", TRAILERS], ids=["headers", "trailers"])
def test_headers_that_never_end_are_cut(start: bytes, piece: bytes) -> None:
    sent = 0
    with (
        serving() as server,
        socket.create_connection(address(server), timeout=10) as line,
        contextlib.suppress(ConnectionError),
    ):
        line.sendall(start)
        while sent < 64 << 20:
            line.sendall(piece)
            sent += len(piece)
    assert sent < 16 << 20  # of which the kernel's buffers take a few


def test_a_taken_port_is_one_line() -> None:
    with listen("127.0.0.1", 0) as taken, pytest.raises(EchoAvatarError, match="choose another"):
        listen("127.0.0.1", taken.getsockname()[1])
