import contextlib
import dataclasses
import json
import logging
import os
import signal
import socket
import ssl
import struct
import threading
import time
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.server.fakes import FAST, Body, RunningServer, serving
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from echoavatar.engine import Engine
from echoavatar.errors import EchoAvatarError
from echoavatar.server import connection, create_app, run, serve
from echoavatar.server.run import JsonFormatter
from echoavatar.wire import sockets
from echoavatar.wire.codec import decode_server, encode, subprotocol
from echoavatar.wire.messages import (
    MAX_MESSAGE_BYTES,
    Audio,
    ClientMessage,
    Encoding,
    End,
    Error,
    Hello,
    Motion,
    Ping,
    Pong,
    Ready,
    Stats,
)
from echoavatar.wire.sockets import ConnectionGuard


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Python's own SIGINT handler, also where the tests run in the background of a shell, which ignores the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_the_server_reports_its_address_and_stops_on_a_signal() -> None:
    told: list[str] = []

    def stop(address: str) -> None:
        told.append(address)
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()

    app = create_app(Engine(Body()), FAST)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        serve(app, port=0, on_ready=stop)
    assert told[0].startswith("http://127.0.0.1:")
    assert not app.state.manager.is_well


def test_a_step_that_never_ends_ends_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that whoever started it starts it again: nothing can stop the thread from inside."""
    monkeypatch.setattr("echoavatar.engine.thread.STUCK_S", 0.2)
    engine, until = Engine(Body()), threading.Event()  # type: ignore[arg-type]
    monkeypatch.setattr(engine.pipeline, "step", lambda *_: until.wait(30))

    def speak(_: str) -> None:
        engine.open_core().push(np.ones(6_400, np.float32))

    with pytest.raises(EchoAvatarError, match="a step has lasted"):
        serve(create_app(engine, FAST), port=0, on_ready=speak)
    assert not until.is_set()
    until.set()


def test_pages_and_sessions_come_over_tls_to_who_trusts_the_certificate(certified: tuple[Path, Path]) -> None:
    trust = ssl.create_default_context(cafile=certified[0])
    with serving(tls=certified) as server:
        with urllib.request.urlopen(f"https://{server.address}/health", timeout=10, context=trust) as answer:
            assert answer.status == 200
        with connect(
            f"wss://{server.address}/v1/stream",
            ssl=trust,
            subprotocols=[subprotocol("msgpack")],  # type: ignore[list-item]
            compression=None,
        ) as line:
            line.send(encode(Hello()))
            assert isinstance(decode_server(line.recv(timeout=10)), Ready)  # type: ignore[arg-type]
        with pytest.raises(OSError, match="CERTIFICATE_VERIFY_FAILED"):
            urllib.request.urlopen(f"https://{server.address}/health", timeout=10)


def test_a_client_that_never_finishes_the_handshake_of_tls_is_closed(
    certified: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda places: ConnectionGuard(places, silence_s=0.3))
    with serving(tls=certified) as server:
        host, port = server.address.split(":")
        began = time.monotonic()
        with socket.create_connection((host, int(port)), 10) as silent:
            silent.sendall(b"\x16\x03\x01\x02\x00")  # a hello of 512 bytes begins, and does not go on
            assert silent.recv(100) == b""
        assert time.monotonic() - began < 5


def test_a_damaged_certificate_is_one_line(certified: tuple[Path, Path], tmp_path: Path) -> None:
    damaged = tmp_path / "cert.pem"
    damaged.write_bytes(certified[0].read_bytes()[:300])
    app = create_app(Engine(Body()), FAST)  # type: ignore[arg-type]
    with pytest.raises(EchoAvatarError, match="belong together"):
        serve(app, port=0, ssl_certfile=str(damaged), ssl_keyfile=str(certified[1]))


def address(server: RunningServer) -> tuple[str, int]:
    host, port = server.address.split(":")
    return host, int(port)


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


@pytest.mark.parametrize(
    "more", ["Content-Length: 5\r\n", "Transfer-Encoding: chunked\r\n", "X: y\r\n" * 200, f"X: {'y' * 9_000}\r\n"]
)
def test_a_request_that_the_websockets_library_cannot_read_is_refused(more: str) -> None:
    with serving() as server, socket.create_connection(address(server), timeout=5) as line:
        line.sendall(
            f"GET /v1/stream HTTP/1.1\r\nHost: {server.address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n{more}\r\n".encode()
        )
        answer = b"".join(iter(lambda: line.recv(4_096), b""))
        assert answer.startswith(b"HTTP/1.1 400")


def test_empty_fragments_do_not_pile_up() -> None:
    with serving() as server, server.call(Hello()) as caller:
        with contextlib.suppress(OSError, ConnectionClosed):
            caller.line.socket.sendall(bytes([0x02, 0x80, 0, 0, 0, 0]))
            for _ in range(60):
                caller.line.socket.sendall(bytes([0x00, 0x80, 0, 0, 0, 0]) * 100)
        assert caller.closing()[0] == 1006


def deaf(place: RunningServer) -> socket.socket:
    """A WebSocket whose client sends and never reads."""
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
    line.settimeout(20)
    line.connect(address(place))
    line.sendall(
        f"GET /v1/stream HTTP/1.1\r\nHost: {place.address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: echoavatar.v1.msgpack\r\n\r\n".encode()
    )
    assert line.recv(12) == b"HTTP/1.1 101"
    return line


def frame(opcode: int, content: bytes) -> bytes:
    """A frame as a client sends it; the mask is zero."""
    return bytes([0x80 | opcode, 0x80 | len(content)]) + bytes(4) + content


@pytest.mark.parametrize("kind", ["control frame", "message"])
def test_pongs_that_are_not_read_do_not_pile_up(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """32 MB of pings whose answers nobody takes: the connection is closed long before that, and memory is not taken."""
    monkeypatch.setattr(run, "CONTROL_FRAMES_AT_ONCE", 1e9)
    monkeypatch.setattr(connection, "SEND_S", 0.5)
    ping = frame(9, bytes(125)) if kind == "control frame" else frame(2, encode(Ping(nonce=7)))
    with serving() as place, place.call(Hello()) as neighbour, deaf(place) as line:
        line.sendall(frame(2, encode(Hello(want=()))))
        most, is_open = 0, True
        for _ in range((32 << 20) // len(ping * 100)):
            try:
                line.sendall(ping * 100)
            except OSError:
                is_open = False
                break
            for one in list(place.uvicorn.server_state.connections):
                most = max(most, one.transport.get_write_buffer_size())
        assert not is_open
        assert most <= (1 << 20) + (1 << 16)
        neighbour.until(Motion)


def test_one_address_does_not_take_all_places_whatever_it_says_its_address_is() -> None:
    few = dataclasses.replace(FAST, connections_per_address=2)
    with serving(settings=few) as place, place.call(Hello()), place.call(Hello()), pytest.raises(InvalidStatus):
        place.call(additional_headers={"X-Forwarded-For": "203.0.113.7"})
    with serving(settings=dataclasses.replace(few, proxies=("127.0.0.1",))) as place, contextlib.ExitStack() as stack:
        for number in range(4):
            forwarded = {"X-Forwarded-For": f"203.0.113.{number}"}
            stack.enter_context(place.call(Hello(), additional_headers=forwarded)).until(Motion)


def test_nothing_is_written_to_a_client_that_is_gone(caplog: pytest.LogCaptureFixture) -> None:
    """A reset shows at the first write; what waits for the client is not written after it."""
    logging.getLogger("asyncio").filters.clear()  # of repeats
    with serving(settings=FAST) as server, server.call(Hello()) as caller:
        caller.until(Motion)
        outbox = server.manager.find(caller.ready.session).source

        def vanish() -> None:
            caller.line.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            caller.line.socket.close()
            for _ in range(50):
                outbox.put(Pong(nonce=1, at=0))

        server.uvicorn.servers[0].get_loop().call_soon_threadsafe(vanish)
        time.sleep(0.3)
        assert server.manager.find(caller.ready.session).source is None
    assert "socket.send() raised exception" not in caplog.text


def test_compressed_messages_are_not_unpacked() -> None:
    """No client can send a bomb, because compression is not agreed on."""
    bomb = zlib.compressobj(wbits=-15)
    packed = bomb.compress(bytes(50_000)) + bomb.flush(zlib.Z_SYNC_FLUSH)
    with serving() as server, connect(f"ws://{server.address}/v1/stream") as line:  # offers permessage-deflate
        assert line.response is not None
        assert "sec-websocket-extensions" not in line.response.headers
        line.socket.sendall(bytes([0xC2, 0x80 | len(packed[:-4]), 0, 0, 0, 0]) + packed[:-4])
        with pytest.raises(ConnectionClosed) as closed:
            line.recv(timeout=10)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1002


def test_a_record_is_one_line_of_json_with_its_session_and_trace() -> None:
    log = logging.Logger("echoavatar.server")
    lines: list[str] = []
    log.handle = lambda record: lines.append(JsonFormatter().format(record))  # type: ignore[method-assign]
    try:
        raise MemoryError("no\nroom")
    except MemoryError:
        log.exception("session %s failed", "abc", extra={"session": "abc"})
    log.warning("told")
    failed, told = (json.loads(line) for line in lines)
    assert not any("\n" in line for line in lines)
    assert (failed["level"], failed["session"], failed["message"]) == ("ERROR", "abc", "session abc failed")
    assert failed["trace"].endswith("room")
    assert set(told) == {"time", "level", "logger", "message"}
    assert told["time"].endswith("Z")


def minute() -> np.ndarray:
    """A minute of sound, PCM16 at 24 kHz: 2.9 MB, and 3.8 MB in base64."""
    return np.full(60 * 24_000, 6_000, "<i2")


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
@pytest.mark.parametrize("waits", [True, False], ids=["after ready", "without waiting for ready"])
def test_a_minute_of_speech_in_one_message_is_taken(encoding: Encoding, waits: bool) -> None:
    with (
        serving() as server,
        connect(
            f"ws://{server.address}/v1/stream",
            subprotocols=[subprotocol(encoding)],  # type: ignore[list-item]
            compression=None,
        ) as line,
    ):

        def say(message: ClientMessage) -> None:
            frame = encode(message, encoding)
            line.send(frame.decode() if encoding == "json" else frame)

        def until(wanted: Callable[[object], bool]) -> None:
            while not wanted(told := decode_server(line.recv(timeout=20), encoding)):
                assert not isinstance(told, Error), told

        say(Hello())
        if waits:
            until(lambda told: isinstance(told, Ready))
        say(Audio(seg=1, start=0, pcm=minute().tobytes()))
        say(End(seg=1))
        until(lambda told: isinstance(told, Stats) and told.queue_ms > 50_000)


def test_a_message_that_is_too_long_is_answered_with_the_limit_and_the_remedy() -> None:
    """The rest of it is read and thrown away: otherwise the reset would take the answer with it."""
    with serving() as server, server.call(Hello()) as neighbour:
        for length in (MAX_MESSAGE_BYTES + 1, 4 * MAX_MESSAGE_BYTES):
            with server.call(Hello()) as caller:
                caller.line.send(bytes(length))
                code, error = caller.closing()
            assert code == 1009
            assert error is not None
            assert (error.code, "8,388,608 bytes" in error.message, "several `audio`" in error.message) == (
                "too_large",
                True,
                True,
            )
        with server.call() as stranger:
            stranger.line.send(bytes(3_000_000))
            code, error = stranger.closing()
            assert (code, error is not None and "after `ready`" in error.message) == (1009, True)
        neighbour.say(Ping(nonce=3))
        assert neighbour.until(Pong).nonce == 3
