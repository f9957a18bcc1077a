import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
import torch
from tests.engine.fakes import FakePipeline, Heard, engine

from echoavatar.engine import Engine, EngineThread
from echoavatar.motion.motion_chunk import MotionChunk


def test_motion_comes_without_anyone_ticking_and_the_thread_ends_when_told() -> None:
    machine = engine()
    with EngineThread(machine) as thread:
        came: list[int] = []
        session = machine.open_core()
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
        machine.open_core().push(np.ones(6_400, np.float32))
        until = time.monotonic() + 5
        while thread.is_alive and time.monotonic() < until:
            time.sleep(0.005)
    assert isinstance(thread.error, TypeError)
    assert "the engine stopped" in caplog.text


class Gated(FakePipeline):
    """A step waits until it may end; who is in one is counted by the value that it hears."""

    def __init__(self) -> None:
        self.inside: list[float] = []
        self.gates = {1.0: threading.Event(), 2.0: threading.Event()}

    def step(self, audio: torch.Tensor, state: Heard, active: torch.Tensor) -> list[MotionChunk]:
        heard = float(audio[0, 0])
        self.inside.append(heard)
        self.gates[heard].wait(10)
        return super().step(audio, state, active)


def soon(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + 5
    while time.monotonic() < until:
        if condition():
            return True
        time.sleep(0.005)
    return False


def test_a_free_worker_takes_what_comes_while_the_other_is_busy() -> None:
    pipeline = Gated()
    machine = Engine(pipeline, seats=2, workers=2)  # type: ignore[arg-type]
    slow, quick = machine.open_core(), machine.open_core()
    with EngineThread(machine):
        slow.push(np.full(6_400, 1, np.float32))
        assert soon(lambda: pipeline.inside == [1])
        quick.push(np.full(6_400, 2, np.float32))
        pipeline.gates[2.0].set()
        assert soon(lambda: quick.made == 6_400 and quick.take() is not None)
        assert slow.take() is None
        pipeline.gates[1.0].set()
        assert soon(lambda: slow.take() is not None)


def test_a_seat_is_not_stepped_twice_at_once_even_if_it_changes_hands() -> None:
    pipeline = Gated()
    machine = Engine(pipeline, seats=1, workers=2)  # type: ignore[arg-type]
    gone = machine.open_core()
    with EngineThread(machine):
        gone.push(np.full(6_400, 1, np.float32))
        assert soon(lambda: pipeline.inside == [1])
        gone.close()
        heir = machine.open_core()
        heir.push(np.full(6_400, 2, np.float32))
        pipeline.gates[2.0].set()
        time.sleep(0.1)
        assert pipeline.inside == [1]
        pipeline.gates[1.0].set()
        assert soon(lambda: pipeline.inside == [1, 2])
        assert soon(lambda: heir.made == 6_400)
    chunk = heir.take()
    assert chunk is not None
    assert float(chunk.motion.root[0, 0]) == 12_800  # from a fresh row
