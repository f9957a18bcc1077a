import os
import signal
import socket
import ssl
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.server.fakes import FAST, Body, serving
from websockets.sync.client import connect

from echoavatar.engine import Engine
from echoavatar.errors import EchoAvatarError
from echoavatar.server import create_app, serve
from echoavatar.wire import Hello, Ready, decode_server, encode, sockets, subprotocol


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
    monkeypatch.setattr(sockets, "SILENCE_S", 0.3)
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
