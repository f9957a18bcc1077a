"""The voice passes byte for byte and in order, whatever happens beside it."""

import asyncio
import contextlib
import http.client
import json
import logging
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

import pytest
from tests.agents.proxy.places import avatar_server, listening, proxied, run, silent, tone
from tests.agents.proxy.scripted import ScriptedSession
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.http11 import Response

from echoavatar.agents.client.connection import quiet_logger
from echoavatar.agents.proxy import ProxySettings, Relay
from echoavatar.agents.proxy import upstream as upstream_module
from echoavatar.agents.proxy.relay import _cancel
from echoavatar.agents.proxy.upstream import dial
from echoavatar.errors import EchoAvatarError
from echoavatar.wire import sockets
from echoavatar.wire.sockets import ConnectionGuard, raise_file_limit

ODD = [
    '{"type":"x",  "spaces" :1}',
    '{"type":"response.output_audio.delta","delta":7,"item_id":[]}',
    '{"type":"response.output_audio.delta","item_id":"i","delta":"***"}',
    '{"type":"response.output_audio.delta","item_id":"i","delta":null,"content_index":"a"}',
    '{"type":"session.updated","session":"none"}',
    '{"type":"session.created","session":{"tools":{"name":[]},"audio":[]}}',
    '{"type":"response.done","response":[[]]}',
    '{"type":"response.done","response":{"id":[]}}',
    '{"type":"response.output_item.done","item":{"type":"function_call","name":{},"call_id":"c"}}',
    '{"type":"response.output_item.done","item":{"type":"function_call","name":[],"call_id":{}}}',
    '{"type":"echoavatar.animation_body.delta"}',
    "no JSON at all",
    "",
    "[" * 2_000,
    '{"type": 5}',
    '"only text"',
    '{"type":"ä\\ud800 \\u0000","big":123456789012345678901234567890,"n":1e400}',
    '{"a":1,"a":2}',
]


@pytest.mark.parametrize("tools", [False, True])
async def test_every_event_passes_byte_for_byte_and_in_order_both_ways(
    tools: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def script(session: ScriptedSession) -> None:
        for text in ODD:
            await session.send_text(text)
        await session.websocket.send(b"\x00\xff binary")
        await session.until("bye")
        await session.websocket.close(4321, "that was all")

    settings = ProxySettings("ws://x", tools=tools)
    with avatar_server() as server:
        async with proxied(script, server.address, settings=settings) as (url, upstream, _):
            async with listening(url) as client:
                for text in ODD:
                    await client.websocket.send(text)
                await client.listen(lambda c: len(c.passed) >= len(ODD) + 2)
                await client.listen(lambda c: bool(c.of("echoavatar.animation_body.delta")))
                await client.say("bye")
                await client.listen()
            [session] = upstream.sessions
            updated = [text for text in session.sent if '"session.updated", ' in text[:30]]
            assert len(updated) == tools  # the answer to our own update, sent because tools were added
            passed = [text for text in client.passed if text not in updated]
            assert passed == [session.sent[0], *ODD, b"\x00\xff binary"]
            assert client.code == 4321
            assert client.websocket.close_reason == "that was all"
    assert "could not be handled" not in caplog.text


async def test_the_upstream_gets_the_clients_bytes() -> None:
    raw: list[object] = []
    from websockets.asyncio.server import serve

    async def keep(line: object) -> None:
        async for message in line:  # type: ignore[attr-defined]
            raw.append(message)

    async with serve(keep, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        relay = Relay(ProxySettings(f"ws://127.0.0.1:{port}/x", avatar="127.0.0.1:9", tools=True))
        async with connect(f"ws://127.0.0.1:{await relay.start(port=0)}") as line:
            for text in ODD:
                await line.send(text)
            await line.send(b"\x01\x02")
            await line.close(4000, "done")
        await asyncio.sleep(0.2)
        await relay.stop()
    assert raw == [text for text in ODD if not text.startswith('{"type":"echoavatar.')] + [b"\x01\x02"]


def test_credentials_query_and_subprotocol_are_passed_on_and_never_written(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    async def conversation() -> None:
        with avatar_server() as server:
            async with proxied(silent, server.address, subprotocols=("realtime",)) as (url, upstream, _):
                headers = {"Authorization": "Bearer sk-very-secret", "OpenAI-Beta": "realtime=v1"}
                options = {
                    "additional_headers": headers,
                    "subprotocols": ["other", "realtime", "openai-insecure-api-key.sk-very-secret"],
                }
                async with listening(f"{url}?model=m&api-key=sk-very-secret", **options) as client:
                    assert client.websocket.subprotocol == "realtime"
                    await client.listen(lambda c: bool(c.added))
                [(path, got)] = upstream.requests
                assert path == "/v1/realtime?model=m&api-key=sk-very-secret"
                assert got["Authorization"] == "Bearer sk-very-secret"
                assert got["OpenAI-Beta"] == "realtime=v1"

    with caplog.at_level(logging.DEBUG):
        run(conversation)
    assert "sk-very-secret" not in caplog.text
    told = capfd.readouterr()
    assert "sk-very-secret" not in told.out + told.err


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


async def test_pings_are_answered_and_long_messages_pass_both_ways() -> None:
    text = json.dumps({"type": "filler", "x": "x" * 3_000_000})
    pongs: list[float] = []

    async def script(session: ScriptedSession) -> None:
        pongs.append(await asyncio.wait_for(await session.websocket.ping(b"from above"), 5))
        await session.send_text(text)

    async with proxied(script) as (url, upstream, _), listening(url, max_size=None) as client:
        pongs.append(await asyncio.wait_for(await client.websocket.ping(b"from below"), 5))
        await client.listen(lambda c: text in c.passed)
        await client.websocket.send(text)
        for _ in range(100):
            if json.loads(text) in upstream.sessions[0].received:
                break
            await asyncio.sleep(0.05)
        else:
            pytest.fail("the long message did not arrive")
    assert len(pongs) == 2


@pytest.mark.parametrize("code", [1000, 1001, 1008, 1011, 1013, 3000, 4999])
async def test_close_codes_pass_both_ways(code: int) -> None:
    async def close(session: ScriptedSession) -> None:
        await session.until("go")
        await session.websocket.close(code, "why")

    async with proxied(close) as (url, _, _), listening(url) as client:
        await client.say("go")
        await client.listen()
        assert (client.code, client.websocket.close_reason) == (code, "why")
    async with proxied(silent) as (url, upstream, _), listening(url) as client:
        await client.listen(lambda c: bool(c.passed))
        await client.websocket.close(code, "why")
        await asyncio.wait_for(upstream.sessions[0].websocket.wait_closed(), 5)
        assert (upstream.sessions[0].websocket.close_code, upstream.sessions[0].websocket.close_reason) == (code, "why")


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


async def test_idle_sockets_lock_nobody_out_and_fill_no_log(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Three times as many as there are places, some with half a request, and as many that hang up."""
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda _: ConnectionGuard(20, silence_s=0.5))
    async with proxied(silent) as (url, _, relay), listening(url) as client:
        port = int(url.split(":")[2].split("/")[0])
        lines = [await asyncio.open_connection("127.0.0.1", port) for _ in range(60)]
        for _, writer in lines[::2]:
            writer.write(b"GET /v1/realtime HTTP/1.1\r\n")
        async with listening(url) as other:
            await other.listen(lambda c: bool(c.passed))
            assert relay.clients == 2
        assert await asyncio.to_thread(_health, port) == {"status": "ready", "clients": 1}
        for reader, writer in lines:
            with suppress(ConnectionError):
                assert await asyncio.wait_for(reader.read(), 5) == b""  # also the newest, after its time
            writer.close()
        await client.listen(lambda c: bool(c.passed))  # a conversation is no silent socket
    assert len(caplog.text) < 20_000


@pytest.mark.slow
def test_more_idle_sockets_than_the_system_allows_files_lock_nobody_out() -> None:
    """Where no more than 1,024 files may be open."""
    raise_file_limit()
    code = (
        "import asyncio; from echoavatar.agents.proxy import ProxySettings, Relay\n"
        "async def run():\n"
        "    print(await Relay(ProxySettings('ws://127.0.0.1:9')).start(port=0), flush=True)\n"
        "    await asyncio.sleep(60)\n"
        "asyncio.run(run())"
    )
    command = ["bash", "-c", 'ulimit -n 1024; exec "$0" -c "$1"', sys.executable, code]
    with (
        contextlib.ExitStack() as stack,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process,
    ):
        stack.callback(process.kill)
        assert process.stdout is not None
        assert process.stderr is not None
        port = int(process.stdout.readline())
        for _ in range(1_100):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        for _ in range(3):
            assert _health(port)["status"] == "ready"
            time.sleep(2)
        process.terminate()
        assert len(process.stderr.read()) < 10_000


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


@pytest.mark.parametrize(("module", "code"), [("upstream", 1011), ("relay", 1009)])
async def test_an_event_beyond_the_limit_ends_its_conversation(
    module: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the upstream or from the client."""
    monkeypatch.setattr(f"echoavatar.agents.proxy.{module}.MAX_BYTES", 10_000)
    long = json.dumps({"type": "filler", "x": "x" * 20_000})

    async def script(session: ScriptedSession) -> None:
        if module == "upstream":
            await session.send_text(long)

    async with proxied(script) as (url, _, _), listening(url, max_size=None) as client:
        if module == "relay":
            await client.websocket.send(long)
        await asyncio.wait_for(client.websocket.wait_closed(), 5)
        assert client.websocket.close_code == code


async def test_an_unreachable_upstream_is_a_bad_gateway_and_foreign_pages_are_refused() -> None:
    relay = Relay(ProxySettings("ws://127.0.0.1:9/v1/realtime"))
    port = await relay.start(port=0)
    for headers, status in (({}, 502), ({"Origin": "https://evil.example"}, 403)):
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws://127.0.0.1:{port}", additional_headers=headers)
        assert refused.value.response.status_code == status
    assert await asyncio.to_thread(_health, port) == {"status": "ready", "clients": 0}
    with pytest.raises(EchoAvatarError, match="cannot listen"):
        await Relay(ProxySettings("ws://x")).start(port=port)
    await relay.stop()


def _health(port: int) -> object:
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    line.request("GET", "/health")
    return json.load(line.getresponse())


async def test_an_upstream_that_drops_ends_one_conversation_and_not_the_next() -> None:
    async def script(session: ScriptedSession) -> None:
        await session.say(tone(0.5))
        session.websocket.transport.abort()

    with avatar_server() as server:
        async with proxied(script, server.address) as (url, upstream, relay):
            for _ in range(2):
                async with listening(url) as client:
                    await client.listen()
                    assert client.code == 1011
                    assert client.passed == upstream.sessions[-1].sent
            assert len(upstream.sessions) == 2
            await asyncio.sleep(0.1)
            assert relay.clients == 0
        assert server.empties()


async def test_a_task_that_swallows_a_cancellation_is_cancelled_again() -> None:
    async def deaf() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60)
        await asyncio.sleep(60)

    task = asyncio.create_task(deaf())
    await asyncio.sleep(0)
    await _cancel(task)
    assert task.cancelled()


async def test_a_client_that_leaves_takes_its_upstream_and_avatar_with_it() -> None:
    with avatar_server() as server:
        async with proxied(silent, server.address) as (url, upstream, relay):
            async with listening(url) as client:
                await client.listen(lambda c: bool(c.of("echoavatar.session.created")))
                await client.websocket.close(4002, "off")
            await upstream.sessions[0].websocket.wait_closed()
            assert upstream.sessions[0].websocket.close_code == 4002
            assert relay.clients == 0
        assert server.empties()


async def test_a_slow_client_gets_all_of_the_voice_and_less_of_the_motion() -> None:
    """The client stops reading for three seconds while 5 MB are sent: the voice arrives whole, motion is left out."""

    async def script(session: ScriptedSession) -> None:
        await session.until("go")
        for number in range(80):
            await session.send_text(json.dumps({"type": "filler", "n": number, "x": "x" * 65_536}))
        await session.say(tone(1.0))

    with avatar_server() as server:
        async with proxied(script, server.address) as (url, upstream, _), listening(url, max_queue=1) as client:
            await client.listen(lambda c: bool(c.of("echoavatar.animation_body.delta")))
            await client.say("go")
            await asyncio.sleep(3)
            before = len(client.of("echoavatar.animation_body.delta"))
            await client.listen(lambda c: any('"response.done"' in text for text in c.passed))
            assert client.passed == upstream.sessions[0].sent
            late = client.of("echoavatar.animation_body.delta")[before:]
            assert len(late) < 8  # three seconds of motion would be 11


def test_a_failed_connection_names_the_address() -> None:
    with pytest.raises(OSError, match="127.0.0.1"):
        asyncio.run(dial("ws://127.0.0.1:9", []))  # type: ignore[arg-type]
