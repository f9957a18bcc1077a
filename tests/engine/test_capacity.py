"""Live sessions on a machine whose clock stands still between events: a step lasts as long as its rows say."""

import time

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline, Heard

from echoavatar.engine import Engine, SessionCore
from echoavatar.engine.capacity import RECENT, Capacity
from echoavatar.errors import AdmissionError
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK

SOUND = np.zeros(CHUNK.samples, np.float32)


class Machine(FakePipeline):
    """One worker. A step of one row lasts 30 ms, and 10 more for every further row, where it has the time to itself."""

    def __init__(self) -> None:
        self.now, self.slower, self.batches = 0.0, 1.0, list[int]()
        self.waits: dict[SessionCore, list[float]] = {}

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        self.batches.append(len(audio))
        self.now += self.slower * (0.02 + 0.01 * len(audio))
        return super().step(audio, state, active)

    def serve(self, engine: Engine, cores: list[SessionCore], chunks: int) -> None:
        """Each session gets a chunk of sound in real time, so many times, at a moment of its own."""
        begun = self.now
        moments = [
            (begun + (chunk + index / len(cores)) * CHUNK.seconds, index)
            for chunk in range(chunks)
            for index in range(len(cores))
        ]
        due, waiting = sorted(moments), {core: list[float]() for core in cores}
        while due or any(waiting.values()):
            while due and due[0][0] <= self.now:
                moment, index = due.pop(0)
                cores[index].push(SOUND)
                cores[index].schedule()
                waiting[cores[index]].append(moment)
            if not engine.work():
                self.now = due[0][0]
            for core in cores:
                while core.take() is not None:
                    self.waits.setdefault(core, []).append(self.now - waiting[core].pop(0))


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr(time, "perf_counter", lambda: machine.now)
    return machine


def test_who_comes_beyond_capacity_is_refused_before_anybody_is_late(machine: Machine) -> None:
    engine = Engine(machine, seats=30, workers=1)  # type: ignore[arg-type]
    admitted: list[SessionCore] = []
    for _ in range(30):
        if engine.free > 0:
            admitted.append(engine.open_core(is_paced=True))
        else:
            with pytest.raises(AdmissionError, match=r"carries \d+ sessions"):
                engine.open_core(is_paced=True)
        machine.serve(engine, admitted, 4)
    assert 6 <= len(admitted) < 20  # 8.9 would fill the time, one by one
    assert max(max(waits) for waits in machine.waits.values()) < 0.15
    admitted.pop().close()
    assert engine.free == 1


def test_sessions_beyond_capacity_are_late_evenly_and_by_little(machine: Machine) -> None:
    """Batches grow until they suffice."""
    engine = Engine(machine, seats=14, workers=1)  # type: ignore[arg-type]
    cores = [engine.open_core() for _ in range(14)]
    machine.serve(engine, cores, 60)
    assert max(max(waits) for waits in machine.waits.values()) < CHUNK.seconds
    means = [np.mean(waits) for waits in machine.waits.values()]
    assert max(means) < 1.5 * min(means)
    assert max(machine.batches) > 2


def test_without_batches_they_would_be_late_by_ever_more(machine: Machine) -> None:
    machine.rows_are_apart = False  # type: ignore[misc]
    engine = Engine(machine, seats=14, workers=1)  # type: ignore[arg-type]
    machine.serve(engine, [engine.open_core() for _ in range(14)], 60)
    assert set(machine.batches) == {1}
    assert min(waits[-1] for waits in machine.waits.values()) > 5


def test_other_programs_take_room_and_those_inside_stay(machine: Machine) -> None:
    engine = Engine(machine, seats=16, workers=1)  # type: ignore[arg-type]
    cores = [engine.open_core(is_paced=True) for _ in range(4)]
    machine.serve(engine, cores, 20)
    before = engine.room
    machine.slower = 2.0
    machine.serve(engine, cores, 20)
    assert engine.room < before
    machine.slower = 3.0
    machine.serve(engine, cores, 20)
    assert engine.free <= 0
    with pytest.raises(AdmissionError):
        engine.open_core(is_paced=True)
    engine.open_core()  # who does not come in real time waits as long as it takes
    assert all(core.error is None and len(machine.waits[core]) == 60 for core in cores)


def test_a_crowd_that_comes_at_once_finds_the_room_measured(machine: Machine) -> None:
    engine = Engine(machine, seats=16, workers=1)  # type: ignore[arg-type]
    assert engine.free == 16
    engine.measure()
    assert engine.free == 6  # of 0.7 times 267 ms, 30 each
    for _ in range(6):
        engine.open_core(is_paced=True)
    assert engine.free == 0


def test_a_batch_is_a_share_of_those_who_need_it_most(machine: Machine) -> None:
    engine = Engine(machine, seats=6, workers=2)  # type: ignore[arg-type]
    cores = [engine.open_core() for _ in range(6)]
    for core in cores:
        core.push(SOUND)
    while engine.work():
        pass
    assert machine.batches == [3, 2, 1]  # no second worker took any
    for core in cores[:2]:
        core.take()
    for core in cores:
        core.push(SOUND)
    assert engine.work()
    assert [core.made for core in cores] == [2 * len(SOUND)] + 5 * [len(SOUND)]  # the others have motion to show


def test_the_last_chunks_count_and_one_session_always_has_room() -> None:
    capacity = Capacity(workers=2, chunk_seconds=0.25)
    assert capacity.room(16) == 16
    for _ in range(RECENT):
        capacity.note(10.0, 1)
    assert capacity.room(16) == 1
    for _ in range(RECENT // 4):
        capacity.note(0.34, 4)
    assert capacity.room(16) == 4
    capacity.forget()
    capacity.note(0.0, 1)
    assert capacity.room(16) == 16
