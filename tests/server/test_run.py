import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from tests.server.fakes import FAST, Body

from echoavatar.engine import Engine
from echoavatar.errors import EchoAvatarError
from echoavatar.server import create_app, serve
from echoavatar.server.run import listen


def test_a_taken_port_is_one_line() -> None:
    with listen("127.0.0.1", 0) as taken, pytest.raises(EchoAvatarError, match="choose another"):
        listen("127.0.0.1", taken.getsockname()[1])


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
