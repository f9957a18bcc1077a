"""Starting: folders, ports, and a real server that answers."""

import contextlib
import dataclasses
import http.client
import json
import socket
import ssl
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from starlette.applications import Starlette
from studio.tests import canned

from echoavatar.errors import EchoAvatarError
from echoavatar.wire import sockets
from echoavatar.wire.rates import Rate
from echoavatar.wire.sockets import ConnectionGuard, WebServer
from echoavatar_studio import run
from echoavatar_studio.app import create_app
from echoavatar_studio.run import open_store


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(EchoAvatarError, match="cannot write"):
        open_store(tmp_path / "file", None)


@contextlib.contextmanager
def running(app: Starlette, monkeypatch: pytest.MonkeyPatch, **options: object) -> Iterator[tuple[str, WebServer]]:
    """uvicorn itself, in a thread: signals are the main thread's, so it is told to stop."""
    monkeypatch.setattr(WebServer, "capture_signals", lambda self: contextlib.nullcontext())
    servers, address, ready = [], [], threading.Event()
    begun = WebServer.__init__

    def kept(self, *args, **kwargs):
        begun(self, *args, **kwargs)
        servers.append(self)

    monkeypatch.setattr(WebServer, "__init__", kept)

    def told(where: str) -> None:
        address.append(where)
        ready.set()

    options = {"host": "127.0.0.1", "port": 0, "on_ready": told} | options
    thread = threading.Thread(target=run.serve, args=(app,), kwargs=options)
    thread.start()
    try:
        assert ready.wait(30)
        yield address[0], servers[0]
    finally:
        servers[0].should_exit = True
        thread.join(30)
    assert not thread.is_alive()


def test_the_studio_answers_over_a_socket(maker, monkeypatch):
    with (
        running(create_app(maker, rates=canned.EASY), monkeypatch) as (address, server),
        urllib.request.urlopen(f"{address}/api/scene", timeout=30) as answer,
    ):
        assert json.load(answer)["frame_rate"] == 30


def test_small_answers_leave_at_once(maker, monkeypatch):
    """Without TCP_NODELAY the kernel holds a small packet back until the one before is acknowledged."""
    with running(create_app(maker, rates=canned.EASY), monkeypatch) as (address, server):
        host, port = address.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as client:
            client.sendall(b"GET /api/scene HTTP/1.1\r\nhost: localhost\r\n\r\n")
            assert client.recv(12) == b"HTTP/1.1 200"
            (connection,) = server.server_state.connections
            line = connection.transport.get_extra_info("socket")
            assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0


@pytest.mark.parametrize(
    ("proxies", "said"), [((), [401, 429, 429]), (("127.0.0.1",), [401, 401, 401])], ids=["no proxy", "proxy"]
)
def test_only_a_named_proxy_says_who_calls(maker, monkeypatch, proxies, said):
    """Each request names another caller; if that were believed, no limit by address would hold."""
    app = create_app(maker, rates=dataclasses.replace(canned.EASY, login=Rate(1, 1e-6)))
    heard = []
    with running(app, monkeypatch, proxies=proxies) as (address, _):
        for number in range(3):
            asked = urllib.request.Request(
                f"{address}/api/owner/login",
                b'{"name": "anna", "password": "guess"}',
                {"content-type": "application/json", "x-forwarded-for": f"203.0.113.{number}"},
            )
            with pytest.raises(urllib.error.HTTPError) as told:
                urllib.request.urlopen(asked, timeout=30)
            heard.append(told.value.code)
    assert heard == said


def is_closed(line: socket.socket) -> bool:
    line.settimeout(5)
    with contextlib.suppress(ConnectionResetError):
        return line.recv(100) == b""
    return True


def test_silent_sockets_lock_nobody_out(maker, monkeypatch):
    """Three times as many as there are places, and requests that never end; a rater is answered."""
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda _: ConnectionGuard(20, silence_s=1.0))
    with running(create_app(maker, rates=canned.EASY), monkeypatch) as (address, _), contextlib.ExitStack() as stack:
        host, port = address.removeprefix("http://").split(":")
        silent = [stack.enter_context(socket.create_connection((host, int(port)))) for _ in range(60)]
        for line in silent[::2]:
            with contextlib.suppress(OSError):
                line.sendall(b"GET /api/scene HTTP/1.1\r\n")
        with urllib.request.urlopen(f"{address}/api/scene", timeout=30) as answer:
            assert answer.status == 200
        assert all(is_closed(line) for line in silent)


def test_a_body_of_two_lengths_is_refused(maker, monkeypatch):
    with running(create_app(maker, rates=canned.EASY), monkeypatch) as (address, _):
        host, port = address.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port)), 10) as line:
            line.sendall(
                b"POST /api/owner/login HTTP/1.1\r\nhost: localhost\r\ncontent-length: 5\r\n"
                b"transfer-encoding: chunked\r\n\r\n0\r\n\r\nGET /api/scene HTTP/1.1\r\n\r\n"
            )
            answer = line.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 400")
    assert answer.count(b"HTTP/1.1") == 1


def test_the_studio_speaks_tls(maker, monkeypatch, certified):
    trust = ssl.create_default_context(cafile=certified[0])
    files = {"certificate": str(certified[0]), "key": str(certified[1])}
    with (
        running(create_app(maker, rates=canned.EASY), monkeypatch, **files) as (address, _),
        urllib.request.urlopen(f"{address}/api/scene", timeout=30, context=trust) as answer,
    ):
        assert (address[:8], answer.status) == ("https://", 200)


@pytest.mark.parametrize(
    ("host", "status"),
    [("studio.example.org", 200), ("127.0.0.1:8768", 200), ("evil.example", 421), ("evil.example:8768", 421)],
)
def test_a_page_that_points_its_own_name_at_the_studio_reads_nothing(maker, monkeypatch, host, status):
    app = create_app(maker, rates=canned.EASY)
    with running(app, monkeypatch, origins=("https://studio.example.org",)) as (address, _):
        line = http.client.HTTPConnection(address.removeprefix("http://"), timeout=10)
        line.request("GET", "/api/scene", headers={"Host": host})
        with line.getresponse() as answer:
            told = answer.read().decode()
        line.close()
    assert answer.status == status
    assert status == 200 or told.endswith("start it with --origin https://evil.example")
