"""Sockets of strangers: they may be many, silent, or never come to an end; a client is served all the same."""

import ast
import asyncio
import contextlib
import http.client
import logging
import re
import socket
import ssl
import time
import tracemalloc
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send
from tests.server.fakes import FAST, RunningServer, serving
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from echoavatar.errors import EchoAvatarError
from echoavatar.wire import sockets
from echoavatar.wire.messages import Hello, Motion
from echoavatar.wire.sockets import ConnectionGuard, RepeatFilter, RequestChecks, listen, raise_file_limit

LIMIT = 40
ROOT = Path(__file__).parents[2]


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


def test_handshakes_that_stall_lock_nobody_out(monkeypatch: pytest.MonkeyPatch, certified: tuple[Path, Path]) -> None:
    """Three times as many as there are places, without a byte, with half a hello and with noise."""
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda _: ConnectionGuard(LIMIT))
    trust = ssl.create_default_context(cafile=certified[0])
    with serving(tls=certified) as server, contextlib.ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(address(server))) for _ in range(3 * LIMIT)]
        for line in idle[::3]:
            line.sendall(b"\x16\x03\x01\x02\x00")
        for line in idle[1::3]:
            with contextlib.suppress(OSError):
                line.sendall(b"GET / HTTP/1.1\r\n\r\n")
        assert is_closed(idle[0])
        with urllib.request.urlopen(f"https://{server.address}/health", timeout=5, context=trust) as answer:
            assert answer.status == 200
        assert len(server.uvicorn.server_state.connections) <= LIMIT


def test_a_handshake_that_stalls_holds_little_memory(certified: tuple[Path, Path]) -> None:
    with serving(tls=certified) as server, contextlib.ExitStack() as stack:
        tracemalloc.start()
        stack.callback(tracemalloc.stop)
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(50):
            stack.enter_context(socket.create_connection(address(server)))
        while len(server.uvicorn.server_state.connections) < 50:
            time.sleep(0.01)
        assert tracemalloc.get_traced_memory()[0] - before < 50 * 100_000  # bytes


def test_a_silent_socket_is_closed_and_so_is_a_request_that_never_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    with small(monkeypatch, silence_s=0.3) as server, contextlib.ExitStack() as stack:
        silent, slow = (stack.enter_context(socket.create_connection(address(server))) for _ in range(2))
        slow.sendall(b"GET /health HTTP/1.1\r\n")
        with server.call(Hello()) as caller:
            assert is_closed(silent)
            assert is_closed(slow)
            time.sleep(0.7)
            caller.until(Motion)  # a WebSocket is no silent socket


def test_a_body_that_never_comes_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an address whose application would wait; bytes that trickle in buy no time."""
    monkeypatch.setattr(sockets, "BODY_S", 0.4)
    monkeypatch.setattr("echoavatar.server.tool_routes.SECONDS", 60)
    with serving() as server, socket.create_connection(address(server)) as slow:
        slow.sendall(
            b"POST /v1/tools/send_action HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 1000\r\n\r\n{"
        )
        begun = time.monotonic()
        slow.settimeout(0.1)
        with contextlib.suppress(ConnectionError):
            while time.monotonic() - begun < 5:
                slow.sendall(b" ")
                with contextlib.suppress(TimeoutError):
                    assert slow.recv(1) == b""
                    break
        assert 0.3 < time.monotonic() - begun < 3


def test_an_answer_that_is_not_read_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A large file for a client that reads nothing, beside one that reads slowly and gets all of it."""
    monkeypatch.setattr(sockets, "UNREAD_S", 0.5)
    asked = b"GET /avatar.glb HTTP/1.1\r\nHost: localhost\r\n"  # twice: the kernel may hold one of them
    asked += b"\r\n" + asked + b"Connection: close\r\n\r\n"
    got = 0
    with serving() as server, contextlib.ExitStack() as stack:
        never, slow = (stack.enter_context(socket.socket()) for _ in range(2))
        for line in (never, slow):
            line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
            line.connect(address(server))
            line.sendall(asked)
        slow.settimeout(10)
        while part := slow.recv(1 << 18):
            got += len(part)
            time.sleep(0.01)
        for _ in range(100):
            if not server.uvicorn.server_state.connections:
                break
            time.sleep(0.05)
        assert not server.uvicorn.server_state.connections
        assert got > 2 * len(urllib.request.urlopen(f"http://{server.address}/avatar.glb").read())


OWN_NAMES = ["localhost", "127.0.0.1", "127.0.0.1:8765", "[::1]:8765", "192.168.1.7", "avatar.example.org:443"]
FOREIGN_NAMES = [
    "evil.example",
    "evil.example:8765",
    "127.0.0.1.evil.example",
    "127.0.0.1@evil.example",
    "",
    "[",
    "a b",
]


@pytest.mark.parametrize("token", ["", "secret"])
def test_a_page_that_points_its_own_name_at_the_server_reads_nothing(token: str) -> None:
    """DNS rebinding: to the browser the page is of the same origin. A token it does not have."""
    with serving(settings=replace(FAST, token=token, origins=("https://avatar.example.org",))) as server:
        line = http.client.HTTPConnection(server.address, timeout=10)

        def ask(path: str, host: str) -> tuple[int, str]:
            line.request("GET", path, headers={"Host": host})
            with line.getresponse() as answer:
                return answer.status, answer.read().decode("latin-1")

        for path in ("/v1/sessions", "/metrics", "/", "/health", "/v1/tools", "/nowhere"):
            needs_token = token and path.startswith(("/v1", "/metrics"))
            for host in OWN_NAMES:
                assert ask(path, host)[0] == (401 if needs_token else 404 if path == "/nowhere" else 200), (path, host)
            for host in FOREIGN_NAMES:
                status, told = ask(path, host)
                if token:
                    assert status == ask(path, "localhost")[0]
                else:
                    assert status == 421
                    assert "start it with --origin https://" in told
                    assert told.count("\n") == 0
        line.close()


def test_a_websocket_of_a_foreign_name_is_refused() -> None:
    with (
        serving() as server,
        socket.create_connection(address(server)) as line,
        pytest.raises(InvalidStatus) as refused,
        connect("ws://evil.example/v1/stream", sock=line),
    ):
        pass
    assert refused.value.response.status_code == 421


async def test_a_request_that_a_stop_cuts_off_is_answered() -> None:
    sent: list[Any] = []

    async def hangs(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.sleep(60)

    async def keep(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        raise AssertionError

    asked = asyncio.create_task(RequestChecks(hangs, None)({"type": "http", "headers": []}, receive, keep))
    await asyncio.sleep(0)
    asked.cancel()
    await asked
    assert [message.get("status") for message in sent] == [503, None]


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


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 65_536), ("127.0.0.1", -1), ("a" * 64 + ".b", 0)])
def test_a_port_or_name_that_cannot_be_is_one_line(host: str, port: int) -> None:
    with pytest.raises(EchoAvatarError, match=rf"cannot listen on {host} port {port}: .*; choose another"):
        listen(host, port)


# ---- every listening socket of the project is opened by this module

LISTENING = ("create_server", "create_unix_server", "create_datagram_endpoint", "start_server", "start_unix_server")
METHODS = (*LISTENING, "bind", "listen")
OTHERS = {
    "self.core.listen": "the avatar hears the other speaker",
    "session.listen": "the avatar hears the other speaker",
    "event.listen": "SQLAlchemy's events",
    "deployment(Avatars, options).bind": "Ray opens the socket of deploy/ray_serve.py itself",
}


def opened(path: Path) -> Iterator[str]:
    """What in a file may open a listening socket, as it is written there."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            known = {"websockets": ("serve", "unix_serve", "server"), "uvicorn": ("Server", "run")}
            doors = (*LISTENING, *known.get((node.module or "").partition(".")[0], ()))
            yield from (f"{node.module}.{name.name}" for name in node.names if name.name in doors)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
            yield ast.unparse(node.func)
        elif isinstance(node, ast.Name | ast.Attribute):
            name = ast.unparse(node)
            if name.endswith(("HTTPServer", "TCPServer", "UDPServer")) or name in ("uvicorn.Server", "uvicorn.run"):
                yield name


def test_every_listening_socket_is_opened_here() -> None:
    """Else a guard guards half of the doors. WebRTC's own UDP is aiortc's; Unity's server takes a socket from here."""
    places = ("src", "lab/src", "studio/src", "tools", "integrations", "deploy")
    words = re.compile("|".join((*METHODS, "HTTPServer|TCPServer|UDPServer|websockets|uvicorn")))
    files = [path for place in places for path in (ROOT / place).rglob("*.py") if words.search(path.read_text("utf-8"))]
    found = {(path.relative_to(ROOT).as_posix(), name) for path in files for name in opened(path) if name not in OTHERS}
    assert {path for path, _ in found} == {"src/echoavatar/wire/sockets.py", "lab/src/echoavatar_lab/unity/serve.py"}


@pytest.mark.parametrize(
    "text",
    [
        "import asyncio\nasyncio.start_server(print)",
        "loop.create_server(print)",
        "from websockets.asyncio.server import serve",
        "from websockets.sync import server",
        "import http.server\nhttp.server.ThreadingHTTPServer(print)",
        "from socket import create_server",
        "import uvicorn\nuvicorn.run(print)",
        "class S(uvicorn.Server): ...",
        "line.bind(('', 0))",
        "line.listen()",
    ],
)
def test_a_listener_is_found(text: str, tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text(text)
    assert list(opened(tmp_path / "code.py"))
