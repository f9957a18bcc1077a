"""The voice passes byte for byte and in order, whatever happens beside it."""

import asyncio
import contextlib
import json
import logging
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest
from tests.agents.proxy.places import avatar_server, health, listening, proxied, run, silent, tone
from tests.agents.proxy.scripted import ScriptedSession
from websockets.asyncio.client import connect

from echoavatar.agents.proxy import ProxySettings, Relay
from echoavatar.agents.proxy.relay import _cancel
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
        assert await asyncio.to_thread(health, port) == {"status": "ready", "clients": 1}
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
            assert health(port)["status"] == "ready"
            time.sleep(2)
        process.terminate()
        assert len(process.stderr.read()) < 10_000


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
