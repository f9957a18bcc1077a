"""Sockets of strangers: they may be many, silent, or noisy; a client is served all the same."""

import contextlib
import logging
import socket
import time
from collections.abc import Iterator

import pytest
from tests.server.fakes import FAST, RunningServer, serving
from websockets.exceptions import ConnectionClosed

from echoavatar.server import run, transport
from echoavatar.server.transport import ConnectionGuard, RepeatFilter, raise_file_limit
from echoavatar.wire import Hello, Motion

LIMIT = 40


def address(server: RunningServer) -> tuple[str, int]:
    host, port = server.address.split(":")
    return host, int(port)


@contextlib.contextmanager
def small(monkeypatch: pytest.MonkeyPatch, *, limit: int = LIMIT, silence_s: float = 10.0) -> Iterator[RunningServer]:
    """A server with few places, or little patience."""
    monkeypatch.setattr(run, "ConnectionGuard", lambda _: ConnectionGuard(limit, silence_s=silence_s))
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


def test_small_messages_leave_at_once() -> None:
    """Without TCP_NODELAY the kernel holds a small packet back until the one before is acknowledged."""
    with serving() as server, server.call(Hello()) as caller:
        caller.until(Motion)
        (connection,) = server.uvicorn.server_state.connections
        line = connection.transport.get_extra_info("socket")
        assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0


@pytest.mark.parametrize("opcode", [0x89, 0x8A], ids=["ping", "pong"])
@pytest.mark.parametrize("hello", [None, Hello()], ids=["before hello", "after hello"])
def test_a_flood_of_control_frames_ends_its_own_connection(opcode: int, hello: Hello | None) -> None:
    with serving() as server, server.call(Hello()) as neighbour, server.call(hello) as caller:
        with contextlib.suppress(OSError, ConnectionClosed):
            for _ in range(200):
                caller.line.socket.sendall(bytes([opcode, 0x80, 0, 0, 0, 0]) * 100)
        assert caller.closing()[0] == 1006
        neighbour.until(Motion)


def test_a_few_pings_are_answered() -> None:
    with serving() as server, server.call(Hello()) as caller:
        assert caller.line.ping().wait(5)
        caller.until(Motion)


def test_empty_fragments_do_not_pile_up() -> None:
    with serving() as server, server.call(Hello()) as caller:
        with contextlib.suppress(OSError, ConnectionClosed):
            caller.line.socket.sendall(bytes([0x02, 0x80, 0, 0, 0, 0]))
            for _ in range(60):
                caller.line.socket.sendall(bytes([0x00, 0x80, 0, 0, 0, 0]) * 100)
        assert caller.closing()[0] == 1006


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
    monkeypatch.setattr(transport.time, "monotonic", lambda: now)
    limiter = RepeatFilter()

    def is_logged(text: str) -> bool:
        return limiter.filter(logging.LogRecord("asyncio", logging.ERROR, "", 0, text, None, None))

    assert [is_logged("out of files"), is_logged("out of files"), is_logged("another")] == [True, False, True]
    now += 11
    assert is_logged("out of files")
