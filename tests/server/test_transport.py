"""WebSockets of strangers: they may be noisy, deaf or gone; a client is served all the same."""

import contextlib
import dataclasses
import logging
import socket
import struct
import time
import zlib

import pytest
from tests.server.fakes import FAST, RunningServer, serving
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from echoavatar.server import connection, transport
from echoavatar.wire import Hello, Motion, Ping, Pong, encode


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
    monkeypatch.setattr(transport, "CONTROL_FRAMES_AT_ONCE", 1e9)
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
