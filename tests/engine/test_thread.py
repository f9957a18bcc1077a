import time

import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine import EngineThread


def test_motion_comes_without_anyone_ticking_and_the_thread_ends_when_told() -> None:
    machine = engine()
    with EngineThread(machine) as thread:
        came: list[int] = []
        session = machine.open()
        session.on_motion = lambda: came.append(1)
        session.push(np.ones(12_800, np.float32))
        until = time.monotonic() + 5
        while len(came) < 2 and time.monotonic() < until:
            time.sleep(0.005)
        assert thread.is_alive
    assert len(came) == 2
    assert session.take() is not None
    assert not thread.is_alive


def test_a_tick_that_fails_is_logged_and_told(caplog: pytest.LogCaptureFixture) -> None:
    machine = engine()
    machine.pipeline.step = None  # type: ignore[assignment]
    with EngineThread(machine) as thread:
        machine.open().push(np.ones(6_400, np.float32))
        until = time.monotonic() + 5
        while thread.is_alive and time.monotonic() < until:
            time.sleep(0.005)
    assert isinstance(thread.error, TypeError)
    assert "the engine stopped" in caplog.text
