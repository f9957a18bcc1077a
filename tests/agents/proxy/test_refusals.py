"""Who may not connect through the proxy, and what a client is told of an upstream that refuses it or is none."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

import pytest
from tests.agents.proxy.places import health, silent
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.http11 import Response

from echoavatar.agents.client.connection import quiet_logger
from echoavatar.agents.proxy import ProxySettings, Relay
from echoavatar.agents.proxy import upstream as upstream_module
from echoavatar.agents.proxy.upstream import dial
from echoavatar.errors import EchoAvatarError


@contextlib.asynccontextmanager
async def answering(raw: bytes | None) -> AsyncIterator[tuple[int, list[bytes]]]:
    """An upstream that answers every request with these bytes (None: with nothing); its port and the requests."""
    requests: list[bytes] = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError):
            requests.append(await reader.readuntil(b"\r\n\r\n"))
        if raw is None:
            await reader.read()
        else:
            writer.write(raw)
        writer.close()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1], requests


async def refusal(upstream_port: int, *, path: str = "/v1/realtime", **options: Any) -> Response:
    """How the proxy refuses a client whose upstream is at this port."""
    relay = Relay(ProxySettings(f"ws://127.0.0.1:{upstream_port}/v1/realtime"))
    port = await relay.start(port=0)
    try:
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws://127.0.0.1:{port}{path}", open_timeout=60, **options)
        assert relay.clients == 0
    finally:
        await relay.stop()
    return refused.value.response


REFUSALS: dict[str, bytes | None] = {
    "refused": b"HTTP/1.1 401 No\r\nContent-Length: 0\r\n\r\n",
    "redirected": b"HTTP/1.1 302 Moved\r\nLocation: ws://127.0.0.1:9/x\r\nContent-Length: 0\r\n\r\n",
    "another protocol": b"SSH-2.0-OpenSSH_9.9\r\n",
    "hung": None,
    "cut": b"HTTP/1.1 101 Switching Protocols\r\n\r\n",
}


@pytest.mark.parametrize("name", REFUSALS)
def test_no_error_shows_a_key(
    name: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """Wherever a client may put its key, whatever the upstream answers, and with every log switched on."""
    monkeypatch.setattr(upstream_module, "TIMEOUT_S", 0.2)

    async def conversation() -> Response:
        async with answering(REFUSALS[name]) as (port, requests):
            told = await refusal(
                port,
                path="/v1/realtime?model=m&api-key=sk-very-secret",
                additional_headers={"Authorization": "Bearer sk-very-secret", "api-key": "sk-very-secret"},
                subprotocols=["realtime", "openai-insecure-api-key.sk-very-secret"],
                logger=quiet_logger(),
            )
        assert requests[0].count(b"sk-very-secret") == 4  # the upstream itself has it
        return told

    with caplog.at_level(logging.DEBUG):
        told = asyncio.run(asyncio.wait_for(conversation(), 30))
    shown = capfd.readouterr()
    for text in (told.body.decode(), str(told.headers), told.reason_phrase, caplog.text, shown.out, shown.err):
        assert "sk-very-secret" not in text


async def test_a_refusal_is_the_upstreams_own() -> None:
    from http import HTTPStatus

    from websockets.asyncio.server import serve

    def refuse(line: object, request: object) -> object:
        return line.respond(HTTPStatus.UNAUTHORIZED, '{"error": "bad key"}')  # type: ignore[attr-defined]

    async with serve(silent, "127.0.0.1", 0, process_request=refuse) as server:  # type: ignore[arg-type]
        port = server.sockets[0].getsockname()[1]
        relay = Relay(ProxySettings(f"ws://127.0.0.1:{port}/v1/realtime"))
        own = await relay.start(port=0)
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws://127.0.0.1:{own}/v1/realtime")
        assert refused.value.response.status_code == 401
        assert refused.value.response.body == b'{"error": "bad key"}'
        assert relay.clients == 0
        await relay.stop()


@pytest.mark.parametrize(("status", "reason"), [(200, "OK"), (429, "Slow down, please"), (499, ""), (520, "Unknown")])
async def test_any_status_is_passed_on_with_its_reason_headers_and_body(status: int, reason: str) -> None:
    raw = (
        f"HTTP/1.1 {status} {reason}\r\nContent-Type: text/x-own\r\nRetry-After: 7\r\nSet-Cookie: a=b\r\n"
        "X-Request-Id: r1\r\nTransfer-Encoding: chunked\r\n\r\n4\r\nbusy\r\n0\r\n\r\n"
    )
    async with answering(raw.encode()) as (port, _):
        told = await refusal(port)
    assert (told.status_code, told.reason_phrase, told.body) == (status, reason, b"busy")
    assert {name.lower(): value for name, value in told.headers.raw_items()} == {
        "content-type": "text/x-own",
        "retry-after": "7",
        "x-request-id": "r1",
        "content-length": "4",
        "connection": "close",
    }


@pytest.mark.parametrize("status", [301, 302, 307, 308])
async def test_redirects_are_refused_so_that_no_key_reaches_another_host(status: int) -> None:
    """The websockets library would follow them with every header but `Authorization`."""
    async with answering(b"HTTP/1.1 401 No\r\nContent-Length: 0\r\n\r\n") as (other, requests):
        raw = f"HTTP/1.1 {status} Moved\r\nLocation: ws://127.0.0.1:{other}/x\r\nContent-Length: 0\r\n\r\n"
        async with answering(raw.encode()) as (port, _):
            told = await refusal(
                port,
                additional_headers={"api-key": "secret"},
                subprotocols=["realtime", "openai-insecure-api-key.secret"],
            )
    assert requests == []
    assert told.status_code == 502
    assert b"redirect" in told.body
    assert "Location" not in told.headers


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"SSH-2.0-OpenSSH_9.9\r\n",
        b"HTTP/1.1 999 What\r\n\r\n",
        b"HTTP/1.1 103 Early Hints\r\n\r\n",
        b"HTTP/1.1 101 Switching Protocols\r\n\r\n",
        b"HTTP/1.1 401 No\r\nX: " + b"x" * 20_000 + b"\r\n\r\n",
        b"HTTP/1.1 401 No\r\nTransfer-Encoding: gzip\r\n\r\n",
    ],
    ids=lambda raw: raw[:30].decode(),
)
async def test_an_upstream_that_does_not_speak_http_is_a_bad_gateway(
    raw: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async with answering(raw) as (port, _):
        told = await refusal(port)
    assert told.status_code == 502
    assert b"upstream" in told.body
    assert "Traceback" not in caplog.text


async def test_an_upstream_that_hangs_is_a_gateway_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upstream_module, "TIMEOUT_S", 0.2)
    async with answering(None) as (port, _):
        told = await refusal(port)
    assert told.status_code == 504
    assert b"0.2 s" in told.body


@pytest.mark.slow
async def test_the_client_is_answered_before_its_own_handshake_times_out() -> None:
    """The real limits: the upstream has 15 s, and the server must hold the client's handshake open for longer."""
    async with answering(None) as (port, _):
        assert (await refusal(port)).status_code == 504


@pytest.mark.parametrize(
    ("host", "status"), [("evil.example", 421), ("evil.example:8766", 421), ("proxy.example.org", 502), ("[::1]", 502)]
)
async def test_a_page_that_points_its_own_name_at_the_proxy_reaches_nothing(host: str, status: int) -> None:
    """Not even with the browser's own word that the page is of the same origin."""
    relay = Relay(ProxySettings("ws://127.0.0.1:9/v1/realtime", origins=("https://proxy.example.org",)))
    port = await relay.start(port=0)
    request = (
        f"GET /v1/realtime HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request.encode())
    told = (await asyncio.wait_for(reader.read(), 10)).decode()
    writer.close()
    await relay.stop()
    assert told.startswith(f"HTTP/1.1 {status} ")
    assert ("start it with --origin https://evil.example" in told) == (status == 421)


async def test_an_unreachable_upstream_is_a_bad_gateway_and_foreign_pages_are_refused() -> None:
    relay = Relay(ProxySettings("ws://127.0.0.1:9/v1/realtime"))
    port = await relay.start(port=0)
    for headers, status in (({}, 502), ({"Origin": "https://evil.example"}, 403)):
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws://127.0.0.1:{port}", additional_headers=headers)
        assert refused.value.response.status_code == status
    assert await asyncio.to_thread(health, port) == {"status": "ready", "clients": 0}
    with pytest.raises(EchoAvatarError, match="cannot listen"):
        await Relay(ProxySettings("ws://x")).start(port=port)
    await relay.stop()


def test_a_failed_connection_names_the_address() -> None:
    with pytest.raises(OSError, match="127.0.0.1"):
        asyncio.run(dial("ws://127.0.0.1:9", []))  # type: ignore[arg-type]
