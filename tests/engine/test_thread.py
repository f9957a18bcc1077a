import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline, Heard, engine

from echoavatar.engine import Engine, EngineThread, SessionCore
from echoavatar.motion.motion_chunk import MotionChunk


def soon(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + 30
    while time.monotonic() < until:
        if condition():
            return True
        time.sleep(0.005)
    return False


def test_motion_comes_without_anyone_ticking_and_the_thread_ends_when_told() -> None:
    machine = engine()
    with EngineThread(machine) as thread:
        came: list[int] = []
        session = machine.open_core()
        session.on_motion = lambda: came.append(1)
        session.push(np.ones(12_800, np.float32))
        assert soon(lambda: len(came) == 2)
        assert thread.is_alive
    assert session.take() is not None
    assert not thread.is_alive


class Faulty(FakePipeline):
    """Half of a step is done when it fails: for a row that hears 13, as often as `faults` says, or while `broken`."""

    faults, broken = 0, False

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        chunks = super().step(audio, state, active)
        if self.broken or self.faults or (audio == 13).any():
            self.faults = max(0, self.faults - 1)
            raise MemoryError("no room")
        return chunks


def shown(core: SessionCore, chunks: int) -> list[float]:
    """The root of so many chunks: the sum of what the row heard."""
    heights: list[float] = []

    def all_came() -> bool:
        while (delivery := core.take()) is not None:
            heights.append(round(float(delivery.motion.root[-1, 0]), -1))  # idle motion adds some millimetres
        return len(heights) >= chunks

    assert soon(all_came)
    return heights


@pytest.mark.parametrize("workers", [0, 2])
def test_a_fault_that_a_session_causes_ends_that_session_alone(workers: int) -> None:
    machine = Engine(Faulty(), seats=2, workers=workers)  # type: ignore[arg-type]
    bad, good = machine.open_core(), machine.open_core()
    bad.push(np.full(6_400, 13, np.float32))
    good.push(np.full(12_800, 1, np.float32))
    with EngineThread(machine) as thread:
        assert shown(good, 2) == [6_400, 12_800]
        assert soon(lambda: isinstance(bad.error, MemoryError))
        bad.close()
        heir = machine.open_core()
        heir.push(np.full(6_400, 2, np.float32))
        assert shown(heir, 1) == [12_800]  # from a fresh row
        assert thread.is_alive
    assert machine.restarts == 0


@pytest.mark.parametrize("workers", [0, 2])
def test_a_passing_fault_costs_nothing(workers: int) -> None:
    pipeline = Faulty()
    machine = Engine(pipeline, seats=2, workers=workers)  # type: ignore[arg-type]
    first, second = machine.open_core(), machine.open_core()
    pipeline.faults = 1
    for core in (first, second):
        core.push(np.ones(12_800, np.float32))
    with EngineThread(machine):
        assert [shown(core, 2) for core in (first, second)] == [[6_400, 12_800]] * 2
    assert machine.restarts == 0


@pytest.mark.parametrize("workers", [0, 2])
def test_an_engine_that_breaks_is_loaded_again_and_the_sessions_go_on(workers: int) -> None:
    """Also one that is interrupted meanwhile: its second chunk is made again, from the sound that it has now."""
    pipeline = Faulty()
    machine = Engine(pipeline, seats=2, workers=workers, reload=Faulty)  # type: ignore[arg-type]
    first, second = machine.open_core(), machine.open_core()
    for core in (first, second):
        core.push(np.ones(12_800, np.float32))
    machine.tick()
    pipeline.broken = True
    assert machine.work()
    assert isinstance(machine.fault, MemoryError)
    second.interrupt(6_400)
    second.push(np.full(6_400, 2, np.float32))
    with EngineThread(machine) as thread:
        assert shown(first, 2) == [6_400, 12_800]
        assert len(shown(second, 2)) == 2
        assert machine._rows.state.total.tolist() == [12_800, 6_400 + 12_800]  # type: ignore[attr-defined]
        assert thread.is_alive
    assert machine.restarts == 1


def test_a_session_whose_chunk_was_stopped_by_a_fault_does_not_wait_for_busy_neighbours() -> None:
    """The neighbour is always due: a machine that is too slow."""
    pipeline = Faulty()
    machine = Engine(pipeline, seats=2, workers=1, reload=Faulty)  # type: ignore[arg-type]
    stopped, busy = machine.open_core(), machine.open_core()
    for core in (stopped, busy):
        core.report_played(0)
    stopped.push(np.ones(6_400, np.float32))
    pipeline.broken = True
    assert machine.work()
    machine.restart()
    for _ in range(4):
        busy.push(np.ones(6_400, np.float32))
        busy.report_played(busy.made)
        assert machine.work()
    assert stopped.take() is not None


def test_motion_that_is_not_finite_ends_its_session() -> None:
    machine = engine(2)
    bad, good = machine.open_core(seed=1), machine.open_core()
    with EngineThread(machine):
        for core in (bad, good):
            core.push(np.ones(6_400, np.float32))
            shown(core, 1)
        machine._rows.state.total[bad.seat] = np.nan  # type: ignore[attr-defined]
        for core in (bad, good):
            core.push(np.ones(6_400, np.float32))
        assert shown(good, 1) == [12_800]
        assert soon(lambda: isinstance(bad.error, FloatingPointError))


def test_an_engine_that_breaks_again_and_again_stops(caplog: pytest.LogCaptureFixture) -> None:
    machine = engine()
    machine.pipeline.step = None  # type: ignore[assignment]
    with EngineThread(machine) as thread:
        machine.open_core().push(np.ones(6_400, np.float32))
        assert soon(lambda: not thread.is_alive)
    assert isinstance(thread.error, TypeError)
    assert machine.restarts == 2
    assert "the engine stopped" in caplog.text


class Gated(FakePipeline):
    """A step waits until it may end; who is in one is counted by the value that it hears."""

    def __init__(self) -> None:
        self.inside: list[float] = []
        self.gates = {1.0: threading.Event(), 2.0: threading.Event()}

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        heard = float(audio[0, 0])
        self.inside.append(heard)
        self.gates[heard].wait(10)
        return super().step(audio, state, active)


def test_a_step_that_never_ends_is_noticed_and_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline = Gated()
    machine = Engine(pipeline, workers=1)  # type: ignore[arg-type]
    try:
        with EngineThread(machine) as thread:
            thread.watch()
            assert not thread.is_stuck
            monkeypatch.setattr("echoavatar.engine.thread.STUCK_S", 0.1)
            machine.open_core().push(np.full(6_400, 1, np.float32))
            assert soon(lambda: thread.watch() or thread.is_stuck)
            assert isinstance(thread.error, TimeoutError)
        assert thread.is_alive
    finally:
        pipeline.gates[1.0].set()
    assert soon(lambda: not thread.is_alive)


def test_hours_in_which_the_process_was_stopped_are_not_counted_as_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-Z, or a computer that sleeps, in the middle of a step; a step that really lasts is still noticed."""
    machine, now = Engine(FakePipeline()), 100.0  # type: ignore[arg-type]
    monkeypatch.setattr("echoavatar.engine.engine.time.monotonic", lambda: now)
    thread = EngineThread(machine)
    machine.open_core().push(np.ones(6_400, np.float32))
    machine._claim(everyone=True)
    for _ in range(3):
        now += 1
        thread.watch()
    now += 8 * 3_600
    thread.watch()
    assert not thread.is_stuck
    for _ in range(60):
        now += 1
        thread.watch()
    assert thread.is_stuck


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
