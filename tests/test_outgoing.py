"""What goes out goes to one origin, ends in time, and shows no key."""

import ast
import asyncio
import base64
import json
import os
import re
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import pytest
from tests.http_server import Act, HttpServer, running
from tests.server.fakes import serving as running_server
from websockets.exceptions import InvalidHandshake

from echoavatar import outgoing
from echoavatar.agents.client import ConnectionLostError, RemoteTools, connect
from echoavatar.agents.integrations.elevenlabs_setup import carry_out, make_plan
from echoavatar.agents.proxy.upstream import dial
from echoavatar.errors import EchoAvatarError
from echoavatar.outgoing import OutgoingError, ask, fetch, redacted
from echoavatar.server.companion import ChatModel, ToolAccess

ROOT = Path(__file__).parents[1]
KEY = "sk-Very/Secret+Key=0123456789"


def serving(act: Act) -> AbstractContextManager[HttpServer]:
    return running(HttpServer(act))


def answering(status: int, body: bytes = b"{}", **headers: str) -> Act:
    return lambda handler: handler.answer(status, body, **headers)


def chat(url: str) -> object:
    async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        return {}

    return asyncio.run(ChatModel(f"{url}/v1", model="m", key=KEY).reply("hi", (), ToolAccess((), do)))


CLIENTS: dict[str, Callable[[str], object]] = {
    "chat": chat,
    "tools": lambda url: RemoteTools(url, token=KEY).sessions(),
    "calls": lambda url: RemoteTools(url, token=KEY).schemas(),
    "elevenlabs": lambda url: carry_out(make_plan([], "", name="n"), api_key=KEY, base_url=url),
    "ask": lambda url: ask(f"{url}/x", headers={"X-Api-Key": KEY}),
}


def told(call: Callable[[], object]) -> tuple[str, str]:
    """The error's message, and all that a traceback shows."""
    with pytest.raises(EchoAvatarError) as caught:
        call()
    return str(caught.value), "".join(traceback.format_exception(caught.value))


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize("status", [300, 301, 302, 303, 307, 308])
def test_no_redirect_carries_a_key_to_another_origin(client: str, status: int) -> None:
    with serving(answering(200)) as other:
        with serving(answering(status, location=f"{other.url}/stolen?key={KEY}")) as server:
            message, trace = told(lambda: CLIENTS[client](server.url))
        assert other.asked == []
    assert f"redirects to 127.0.0.1:{other.server_port}" in message
    assert KEY not in trace


def test_a_redirect_within_the_origin_is_followed_but_not_from_a_post() -> None:
    def act(handler: Any) -> None:
        if handler.path == "/there":
            return answering(200, b'{"is": "here"}')(handler)
        return answering(302, b"x" * 10, location="/there")(handler)

    with serving(act) as server:
        assert ask(f"{server.url}/here", headers={"authorization": f"Bearer {KEY}"}) == {"is": "here"}
        assert [headers["authorization"] for _, _, headers in server.asked] == [f"Bearer {KEY}"] * 2
        with pytest.raises(OutgoingError, match="redirects to another address"):
            ask(f"{server.url}/here", {})
        assert len(server.asked) == 3


def test_a_redirect_in_a_circle_or_with_an_endless_body_is_given_up() -> None:
    def act(handler: Any) -> None:
        handler.send_response(302)
        handler.send_header("location", f"/again{len(server.asked)}")
        handler.end_headers()
        for _ in range(1000):
            handler.wfile.write(b"x" * (1 << 20))

    with serving(act) as server:
        began = time.monotonic()
        with pytest.raises(OutgoingError, match="HTTP 302"):
            fetch(server.url)
        assert time.monotonic() - began < 3


@pytest.mark.parametrize("place", ["http://[::1", "http://", "file:///etc/passwd", "//", "http://a@b/", "\x1b[2J"])
def test_an_odd_redirect_is_one_error(place: str) -> None:
    with serving(answering(302, location=place)) as server, pytest.raises(EchoAvatarError) as caught:
        fetch(server.url)
    assert str(caught.value).isprintable()


ECHOES = {
    "raw": KEY,
    "in JSON": json.dumps({"detail": {"status": f"invalid {KEY}"}}),
    "upper case": KEY.upper(),
    "percent-encoded": "sk-Very%2FSecret%2BKey%3D0123456789",
    "the header": f"authorization: Bearer {KEY}",
    "half of it": f"no such key {KEY[:16]}***",
    "the end of it": f"no such key ***{KEY[-12:]}",
    "at the cut": "x" * (outgoing.SHOWN_LETTERS - 8) + KEY,
    "wide": f"\0\x1b[2J{KEY}\r\n{KEY}",
}


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize("echo", ECHOES)
def test_an_answer_that_repeats_the_key_is_not_repeated(client: str, echo: str, caplog: Any) -> None:
    caplog.set_level(0)
    with serving(answering(403, ECHOES[echo].encode())) as server:
        message, trace = told(lambda: CLIENTS[client](server.url))
    shown = (trace + caplog.text).lower()
    for piece in [KEY[at : at + 8].lower() for at in range(len(KEY) - 7)] + ["very%2fsecret"]:
        assert piece not in shown
    assert message.isprintable()


@pytest.mark.parametrize("client", CLIENTS)
def test_a_reason_that_repeats_the_key_is_not_repeated(client: str) -> None:
    def act(handler: Any) -> None:
        handler.wfile.write(f"HTTP/1.1 401 key {KEY}\r\ncontent-length: 0\r\n\r\n".encode())

    with serving(act) as server:
        assert KEY not in told(lambda: CLIENTS[client](server.url))[1]

    def nonsense(handler: Any) -> None:
        handler.wfile.write(f"{KEY}\r\n".encode())

    with serving(nonsense) as server:
        assert KEY not in told(lambda: CLIENTS[client](server.url))[1]


@pytest.mark.parametrize("key", ["two\nlines", "\u20ac", "tab\tand\0null"])
def test_a_key_that_fits_no_header_is_not_shown(key: str) -> None:
    message, trace = told(lambda: ask("http://127.0.0.1:9/", headers={"x-key": f"{key}{KEY}"}))
    assert KEY not in trace
    assert message


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("http://me:pass@h:1/x", "http://...h:1/x"),
        ("https://me:pa/ss@h/x", "https://...h/x"),
        ("http://us'er:pa\"ss@h/x", "http://...h/x"),
        ("http://h/x?key=abc#def", "http://h/x..."),
        ("wss://h/x#abc", "wss://h/x..."),
        ("rtmp://a.example/live2/KEY-1", "rtmp://a.example/..."),
        ("RTMPS://me:pass@a.example/live2/KEY playpath=KEY", "RTMPS://...a.example/..."),
        ("see http://h/x for more", "see http://h/x for more"),
        ("out.flv", "out.flv"),
        ("two\r\nlines\x1b[2J", "two lines [2J"),
    ],
)
def test_addresses_hide_what_opens_something(text: str, shown: str) -> None:
    assert redacted(text) == shown


def test_a_secret_in_the_query_is_hidden_where_the_answer_repeats_it() -> None:
    with serving(answering(400, f"bad {KEY}".encode())) as server:
        message, trace = told(lambda: fetch(f"{server.url}/x?token={KEY}&page=1"))
        assert f"token={KEY}" in server.asked[0][1]
    assert "/x... answers HTTP 400: bad ..." in message
    assert KEY not in trace


@pytest.mark.parametrize("url", ["http://me:pass@127.0.0.1:9/", "file:///etc/passwd", "127.0.0.1", "http://h:0/",
                                 "http://[::1", "http://h:99999/", "", "http:///x", "ftp://h/", "data:,x"])  # fmt: skip
def test_addresses_that_are_none_are_refused_in_one_line(url: str) -> None:
    message, trace = told(lambda: fetch(url, headers={"x-key": KEY}))
    assert "pass@" not in trace.replace("passwd", "")
    assert message.isprintable()


def drip(part: bytes) -> Act:
    def act(handler: Any) -> None:
        for letter in part + b"x" * 1000:
            with suppress(OSError):
                handler.wfile.write(bytes([letter]))
            time.sleep(0.02)

    return act


SLOW: dict[str, Act] = {
    "silent": lambda handler: time.sleep(3),
    "status dripped": drip(b"HTTP/1.1 200 "),
    "headers dripped": drip(b"HTTP/1.1 200 OK\r\nx: "),
    "continues for ever": drip(b"HTTP/1.1 100 Continue\r\n\r\n" * 100),
    "body dripped": drip(b"HTTP/1.1 200 OK\r\ncontent-length: 1000\r\n\r\n"),
    "chunks dripped": drip(b"HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 100),
    "refusal dripped": drip(b"HTTP/1.1 500 No\r\ncontent-length: 1000\r\n\r\n"),
    "body without end": drip(b"HTTP/1.1 200 OK\r\n\r\n"),
}


@pytest.mark.parametrize("kind", SLOW)
def test_an_exchange_ends_in_time_however_it_drips(kind: str) -> None:
    with serving(SLOW[kind]) as server:
        began = time.monotonic()
        with pytest.raises(OutgoingError, match="nothing whole within|HTTP 500"):
            fetch(server.url, {}, seconds=0.4)
        assert time.monotonic() - began < 1.5


def test_a_request_that_nobody_reads_ends_in_time() -> None:
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        for scheme in ("http", "https"):  # the second hangs in the handshake of TLS
            began = time.monotonic()
            with pytest.raises(OutgoingError, match="nothing whole within"):
                fetch(f"{scheme}://127.0.0.1:{deaf.getsockname()[1]}", b"x" * (32 << 20), seconds=0.4)
            assert time.monotonic() - began < 1.5


def test_an_answer_that_is_too_long_or_too_short_is_cut() -> None:
    def endless(handler: Any) -> None:
        handler.send_response(200)
        handler.end_headers()
        for _ in range(100_000):
            handler.wfile.write(b"x" * 10_000)

    with serving(endless) as server, pytest.raises(OutgoingError, match="more than 1,000 bytes"):
        fetch(server.url, most=1000)
    short = answering(200, b"x" * 10, **{"content-length": "20"})
    with serving(short) as server, pytest.raises(OutgoingError, match="10 bytes early"):
        fetch(server.url)


@pytest.mark.parametrize("body", [b"<html>", b"[" * 5000, b'"\\ud800"', b"NaN", b"\xff", b'{"a": 1e999}'])
def test_an_answer_goes_through_the_one_reader_of_json(body: bytes) -> None:
    with serving(answering(200, body)) as server:
        with pytest.raises(OutgoingError, match="JSON"):
            ask(server.url)
        for client in ("chat", "tools", "elevenlabs"):
            told(lambda client=client: CLIENTS[client](server.url))


PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "WS_PROXY", "WSS_PROXY")


@pytest.fixture
def proxy(monkeypatch: pytest.MonkeyPatch) -> Iterator[HttpServer]:
    with serving(answering(502)) as proxy:
        for name in PROXIES:
            monkeypatch.setenv(name, proxy.url)
            monkeypatch.setenv(name.lower(), proxy.url)
        for name in ("NO_PROXY", "no_proxy"):
            monkeypatch.delenv(name, raising=False)
        yield proxy


def test_this_machine_is_never_asked_through_a_proxy(proxy: HttpServer) -> None:
    with serving(answering(200, b'{"a": 1}')) as server:
        for host in ("127.0.0.1", "localhost", "127.1", "0x7f000001"):
            assert ask(f"http://{host}:{server.server_port}/") == {"a": 1}
        with pytest.raises(OutgoingError):
            ask(f"https://127.0.0.1:{server.server_port}/", seconds=1)
        asyncio.run(_websockets(f"ws://127.0.0.1:{server.server_port}"))
        asyncio.run(_websockets(f"ws://localhost:{server.server_port}"))
    assert proxy.asked == []


async def _websockets(url: str) -> None:
    with pytest.raises(ConnectionLostError):
        async with connect(url):
            pass
    with pytest.raises(InvalidHandshake):
        await dial(f"{url}/v1/realtime", [])


PRIVATE = [
    "127.0.0.1", "::1", "::ffff:127.0.0.1", "10.1.2.3", "192.168.1.2", "172.16.0.1", "169.254.1.1", "fe80::1",
    "fd00::1", "100.64.0.1", "0.0.0.0", "localhost",
]  # fmt: skip


@pytest.mark.parametrize("host", PRIVATE)
def test_private_hosts(host: str) -> None:
    assert outgoing.is_private(host)


@pytest.mark.parametrize("host", ["8.8.8.8", "2606:4700::1111", "no.such.host.invalid", "x" * 300, ""])
def test_public_hosts(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def look_up(name: str, _: object) -> list[Any]:
        if name[:1].isdigit():
            return [(0, 0, 0, "", (name, 0))]
        raise socket.gaierror("unknown")

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    assert not outgoing.is_private(host)


def test_other_machines_are_asked_through_the_proxy(proxy: HttpServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outgoing, "is_private", lambda host: host == "127.0.0.1")
    with pytest.raises(OutgoingError, match="HTTP 502"):
        ask("http://model.example/v1", headers={"x-key": KEY})
    assert [path for _, path, _ in proxy.asked] == ["http://model.example/v1"]
    with pytest.raises(OutgoingError):
        ask("https://model.example/v1", headers={"x-key": KEY})
    assert KEY not in json.dumps(proxy.asked[1:])


def test_websockets_to_other_machines_go_through_any_kind_of_proxy(
    proxy: HttpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outgoing, "is_private", lambda host: host == "127.0.0.1")
    for name in PROXIES:
        monkeypatch.delenv(name)
        monkeypatch.delenv(name.lower())
    monkeypatch.setenv("ALL_PROXY", proxy.url.removeprefix("http://"))

    async def go(*addresses: str) -> None:
        for address in addresses:
            with pytest.raises(EchoAvatarError) as raised:
                async with connect(address):
                    pass
            said.append(str(raised.value))

    said: list[str] = []
    asyncio.run(go("ws://avatar.example", "https://avatar.example"))
    assert [(how, path) for how, path, _ in proxy.asked] == [
        ("CONNECT", "avatar.example:80"), ("CONNECT", "avatar.example:443"),
    ]  # fmt: skip
    with pytest.raises(OutgoingError, match="HTTP 502"):
        ask("http://avatar.example/v1/tools")
    monkeypatch.setenv("ALL_PROXY", "socks://me:secret@127.0.0.1:9")
    asyncio.run(go("ws://avatar.example"))
    with pytest.raises(OutgoingError) as refused:
        ask("https://avatar.example/v1/tools")
    for text in (said[-1], str(refused.value)):
        assert "HTTPS_PROXY" in text
        assert "secret" not in text


@pytest.mark.parametrize(
    ("url", "set_to", "expected"),
    [
        ("wss://a.example/x", {"HTTPS_PROXY": "http://p:1"}, "http://p:1"),
        ("wss://a.example/x", {"HTTP_PROXY": "http://p:1"}, None),
        ("ws://a.example/x", {"HTTP_PROXY": "http://p:1"}, "http://p:1"),
        ("https://a.example", {"https_proxy": "p:1", "ALL_PROXY": "http://q:1"}, "http://p:1"),
        ("https://a.example", {"ALL_PROXY": "http://q:1"}, "http://q:1"),
        ("wss://a.example", {"SOCKS_PROXY": "http://q:1"}, "socks5h://q:1"),
        ("wss://a.example:8443", {"HTTPS_PROXY": "http://p:1", "NO_PROXY": ".example"}, None),
        ("wss://a.example:8443", {"HTTPS_PROXY": "http://p:1", "NO_PROXY": "a.example:8443"}, None),
        ("wss://a.example:8443", {"HTTPS_PROXY": "http://p:1", "NO_PROXY": "a.example:443"}, "http://p:1"),
        ("wss://a.example", {"HTTPS_PROXY": "http://p:1", "no_proxy": "*"}, None),
        ("ws://me:pw@10.0.0.5:1/x", {"HTTP_PROXY": "http://p:1"}, None),
        ("ws://[fd00::7]:1/x", {"HTTP_PROXY": "http://p:1"}, None),
        ("ws://[fe80::7%25eth9]:1/x", {"HTTP_PROXY": "http://p:1"}, None),
        ("http://printer.local", {"HTTP_PROXY": "http://p:1"}, None),
        ("http://a.localhost:3000", {"HTTP_PROXY": "http://p:1"}, None),
        ("http://LOCALHOST.:3000", {"HTTP_PROXY": "http://p:1"}, None),
        ("ws://10.0.0.5", {"HTTP_PROXY": "http://p:1", outgoing.PROXY_PRIVATE: "1"}, "http://p:1"),
        ("ws://10.0.0.5", {"HTTP_PROXY": "http://p:1", outgoing.PROXY_PRIVATE: "1", "NO_PROXY": "10.0.0.5"}, None),
        ("ws://a.example", {}, None),
    ],
)
def test_one_rule_says_which_proxy(
    url: str, set_to: dict[str, str], expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in list(os.environ):
        if name.lower().endswith("_proxy") or name == outgoing.PROXY_PRIVATE:
            monkeypatch.delenv(name)
    for name, value in set_to.items():
        monkeypatch.setenv(name, value)
    look_up = socket.getaddrinfo

    def known(host: str, *rest: Any) -> Any:
        return look_up("8.8.8.8" if host.endswith(".example") else host, *rest)

    monkeypatch.setattr(socket, "getaddrinfo", known)
    assert outgoing.proxy_for(url) == expected


def test_a_websocket_follows_no_redirect() -> None:
    with serving(answering(200)) as other:
        place = other.url.replace("http", "ws")
        with serving(answering(302, location=place)) as server:

            async def go() -> None:
                with pytest.raises(ConnectionLostError):
                    async with connect(server.url, token=KEY):
                        pass

            asyncio.run(go())
        assert other.asked == []


def test_what_our_server_says_at_length_is_told_whole() -> None:
    said = "no such action; there are: " + ", ".join(f"action_{k}" for k in range(100))
    with serving(answering(400, json.dumps({"error": said}).encode())) as server:
        assert RemoteTools(server.url).call("send_action", {})["reason"].endswith(f"refused: {said}")


def test_no_log_of_a_websocket_shows_a_token(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(0)
    with running_server() as server:

        async def go() -> None:
            async with connect(f"ws://me:password@{server.address}/v1/stream", token=KEY):
                pass

        asyncio.run(go())
    sent = "\n".join(
        record.getMessage() for record in caplog.records if ".client" in record.name or "agents" in record.name
    )
    for form in (KEY, KEY.encode().hex(" "), base64.b64encode(b"me:password").decode()):
        assert form[:20] not in sent


def test_an_address_with_a_password_is_not_shown_where_no_server_answers() -> None:
    async def go() -> None:
        async with connect("ws://me:password@127.0.0.1:9/v1/stream?token=abcdef", token=KEY):
            pass

    _, trace = told(lambda: asyncio.run(go()))
    assert "password@" not in trace.split("ConnectionLostError")[-1]
    assert "abcdef" not in trace.split("ConnectionLostError")[-1]
    assert base64.b64encode(b"me:password").decode() not in trace


CLIENT_MODULES = {"urllib.request", "http.client", "requests", "httpx", "httpx2", "aiohttp", "urllib3", "urlopen",
                  "ftplib", "smtplib"}  # fmt: skip
ALLOWED = {
    "src/echoavatar/outgoing.py": "the one client",
    "lab/src/echoavatar_lab/bench/hostile_clients.py": "attacks the server that it was given",
    "src/echoavatar/server/tracing.py": "tells the collector's exporter which proxy is meant",
}
DIALLERS = {"connect", "unix_connect", "create_connection", "ws_connect"}
MAY_DIAL = {
    "src/echoavatar/agents/client/connection.py": "the one WebSocket",
    "lab/src/echoavatar_lab/bench/hostile_clients.py": "from threads, through the same proxy",
}


def _http_clients(path: Path) -> set[str]:
    """The HTTP clients that a file imports or calls."""
    found, text = set(), path.read_text("utf-8")
    if not any(all(part in text for part in name.split(".")) for name in (*CLIENT_MODULES, "urlopen")):
        return set()  # sooner than by parsing
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Attribute) and node.attr == "urlopen":
            found.add(node.attr)
    return {name for name in found if any(name == one or name.startswith(f"{one}.") for one in CLIENT_MODULES)}


def _websockets_opened(source: str) -> set[str]:
    """What opens WebSockets in a source: functions of `websockets` and the like, imported or called by their module."""
    found = set()
    if not re.search("websocket|aiohttp|ws_connect", source):
        return found  # sooner than by parsing
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and re.match(r"websockets?\b", node.module or "") and not node.level:
            found |= DIALLERS & {alias.name for alias in node.names}
            found |= {alias.name for alias in node.names if alias.name == "client"}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if re.match(r"(websockets?|aiohttp)\b", alias.name)}
        elif isinstance(node, ast.Attribute) and node.attr == "ws_connect":
            found.add(node.attr)
    return found


def _sources() -> dict[str, Path]:
    places = [ROOT / place for place in ("src", "lab/src", "studio/src", "tools/character/src", "integrations")]
    files = [path for place in places for path in place.rglob("*.py") if "tests" not in path.parts]
    assert len(files) > 400
    return {path.relative_to(ROOT).as_posix(): path for path in files}


def test_nothing_else_is_an_http_client() -> None:
    found = {name: clients for name, path in _sources().items() if (clients := _http_clients(path))}
    assert set(found) == set(ALLOWED), found


def test_nothing_else_opens_a_websocket() -> None:
    for bad in ("import websockets", "from websockets.sync.client import connect as c", "s.ws_connect('ws://x')",
                "from websockets.asyncio import client", "from websocket import create_connection"):  # fmt: skip
        assert _websockets_opened(bad), bad
    found = {name: how for name, path in _sources().items() if (how := _websockets_opened(path.read_text("utf-8")))}
    assert set(found) == set(MAY_DIAL), found
    for name in MAY_DIAL:
        source = (ROOT / name).read_text("utf-8")
        assert "proxy=" in source, f"{name} names no proxy"
        assert "outgoing.proxy_for" in source
