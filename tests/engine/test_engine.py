import gc
import threading
import time
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline, Heard, engine

from echoavatar.engine import Engine, Session, load
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.engine.pipeline.undo import Patch, Rows
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.motion_chunk import MotionChunk


def test_seats_are_taken_freed_and_refused() -> None:
    machine = engine(seats=2)
    first, second = machine.open(), machine.open()
    with pytest.raises(EchoAvatarError, match="all 2 seats are taken"):
        machine.open()
    first.close()
    first.close()  # closing twice frees one seat only
    third = machine.open(seed=5)
    assert third.core.seat == first.core.seat != second.core.seat


def test_a_new_session_does_not_remember_the_last_one_on_its_seat() -> None:
    machine = engine()
    with machine.open() as session:
        session.push(np.ones(6_400, np.float32))
        assert len(list(session)) == 1
    with machine.open(seed=5) as session:
        session.push(np.zeros(6_400, np.float32))
        assert round(float(next(iter(session)).root[0, 1]), 3) == 5


def test_one_tick_moves_every_waiting_session_and_nobody_else() -> None:
    machine = engine(seats=3)
    sessions = [machine.open_core() for _ in range(3)]
    sessions[0].push(np.ones(12_800, np.float32))
    sessions[2].push(np.full(6_400, 2, np.float32))
    assert machine.tick() == 2
    assert machine.tick() == 1
    assert machine.tick() == 0
    totals = [[round(float(chunk.root[0, 1]), 3) for chunk in Session(session)] for session in sessions]
    assert totals == [[6_400, 12_800], [], [12_800]]


def test_no_seats_is_refused() -> None:
    with pytest.raises(EchoAvatarError, match="at least one seat"):
        engine(seats=0)


class Meeting(FakePipeline):
    """Every step waits until another one runs beside it."""

    def __init__(self) -> None:
        self.door = threading.Barrier(2)
        self.rows: list[int] = []

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
        self.rows.append(len(audio))
        self.door.wait(10)
        return super().step(audio, state, active)


def test_two_workers_step_two_sessions_side_by_side_each_by_itself() -> None:
    pipeline = Meeting()
    machine = Engine(pipeline, seats=3, workers=2)  # type: ignore[arg-type]
    sessions = [machine.open_core(seed=seat) for seat in range(3)]
    for session, value in zip(sessions, (1, 0, 3), strict=True):
        if value:
            session.push(np.full(6_400, value, np.float32))
    assert machine.tick() == 2
    assert pipeline.rows == [1, 1]
    assert [[round(float(chunk.root[0, 1]), 3) for chunk in Session(session)] for session in sessions] == [
        [6_400],
        [],
        [19_202],
    ]


def test_a_failure_in_a_worker_is_raised_by_tick() -> None:
    class Failing(FakePipeline):
        def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> list[MotionChunk]:
            raise EchoAvatarError("no")

    machine = Engine(Failing(), workers=2)  # type: ignore[arg-type]
    machine.open_core().push(np.ones(6_400, np.float32))
    with pytest.raises(EchoAvatarError, match="no"):
        machine.tick()


def test_without_workers_all_sessions_are_one_batch() -> None:
    pipeline = Meeting()
    pipeline.door = threading.Barrier(1)
    machine = Engine(pipeline, seats=3, workers=0)  # type: ignore[arg-type]
    for _ in range(2):
        machine.open_core().push(np.ones(6_400, np.float32))
    assert machine.tick() == 2
    assert pipeline.rows == [3]


def test_the_session_with_the_least_motion_ahead_is_stepped_first() -> None:
    machine = engine(seats=2)
    flooding, modest = machine.open_core(), machine.open_core()
    flooding.push(np.ones(64_000, np.float32))
    assert machine.work()
    modest.push(np.ones(6_400, np.float32))
    assert machine.work()
    assert (flooding.made, modest.made) == (6_400, 6_400)
    assert machine.work()
    assert flooding.made == 12_800


CHUNKS = 12


def sound(seed: int) -> np.ndarray:
    return (0.1 * np.random.default_rng(seed).standard_normal(CHUNKS * 6_400)).astype(np.float32)


def test_neighbours_in_other_workers_change_nothing(tiny_bundle: Path) -> None:
    """Five sessions that come and wait at odd moments, three workers: the motion is that of each alone, to the bit."""
    pipeline = Pipeline(load_bundle(tiny_bundle))
    engine = Engine(pipeline, seats=5, workers=3)
    sessions = [engine.open_core(seed=seed) for seed in range(5)]
    sounds = [sound(seed) for seed in range(5)]
    for chunk in range(CHUNKS):
        for seat, (session, whole) in enumerate(zip(sessions, sounds, strict=True)):
            if (chunk + seat) % 3:  # the others get theirs later, two at once
                session.push(whole[: (chunk + 1) * 6_400][int(session.made + 24_000 * session.seconds_waiting) :])
        engine.tick()
    for session, whole in zip(sessions, sounds, strict=True):
        session.push(whole[int(session.made + 24_000 * session.seconds_waiting) :])
    while engine.tick():
        pass
    for seed, (session, whole) in enumerate(zip(sessions, sounds, strict=True)):
        alone = Engine(pipeline, workers=1).open_core(seed=seed)
        alone.push(whole)
        for made, witness in zip(Session(session), Session(alone), strict=True):
            assert np.array_equal(made.rotations, witness.rotations)
            assert np.array_equal(made.root, witness.root)
        assert session.made == alone.made == len(whole)


def test_a_fault_in_any_stage_is_taken_back_and_the_chunk_made_again(tiny_bundle: Path, voice: np.ndarray) -> None:
    """To the bit: each stage in turn runs out of memory once, amid the step of one chunk."""

    def run(stages: list[str]) -> list[MotionChunk]:
        pipeline = Pipeline(load_bundle(tiny_bundle), precision="float32")
        machine = Engine(pipeline, workers=1)

        is_armed = False

        def fail(stage: str) -> None:
            nonlocal is_armed
            if is_armed and stages and stage == stages[0]:
                is_armed = False
                raise MemoryError(stages.pop(0))

        session = machine.open(seed=3)
        session.push(np.tile(voice, 2)[:128_000])
        made = []
        while machine.work():
            is_armed, pipeline.on_stage = True, fail  # from the second chunk on
            made += list(iter(session.core.take, None))
        assert machine.restarts == 0
        return [delivery.motion for delivery in made]

    passed: list[str] = []
    pipeline = Pipeline(load_bundle(tiny_bundle))
    pipeline.on_stage = passed.append
    pipeline.step(np.zeros((1, 6_400), np.float32), pipeline.init_state(1), np.ones(1, np.bool_))
    todo = list(dict.fromkeys(passed))
    faulty, sound = run(todo), run([])
    assert not todo
    assert len(faulty) == len(sound) > 8
    for one, other in zip(faulty, sound, strict=True):
        np.testing.assert_array_equal(one.rotations, other.rotations)
        np.testing.assert_array_equal(one.root, other.root)


def test_a_worker_to_spare_makes_the_face_and_after_a_fault_it_is_waited_for(tiny_bundle: Path) -> None:
    """Beside the body, to the bit as after it; a body that fails leaves no thread that still writes to the face."""
    bundle, whole = load_bundle(tiny_bundle), sound(0)
    bundle = replace(bundle, parts={**bundle.parts, "face": load_bundle().parts["face"]})
    threads: dict[str, set[str]] = {}

    def run(workers: int, faults: int) -> list[MotionChunk]:
        pipeline = Pipeline(bundle)
        machine = Engine(pipeline, workers=workers)

        def note(stage: str) -> None:
            nonlocal faults
            threads.setdefault(f"{stage} {workers}", set()).add(threading.current_thread().name)
            if stage == "face":
                time.sleep(0.02)  # so that the body fails first
            if stage == "codec" and faults:
                faults -= 1
                raise MemoryError("no room")

        pipeline.warm_up()
        pipeline.on_stage = note
        session = machine.open(seed=3)
        session.push(whole)
        for _ in range(faults):
            with pytest.raises(MemoryError):
                machine.tick()
        return list(session)

    alone, beside, repeated = run(1, 0), run(2, 0), run(2, 3)
    assert threads["face 1"] == threads["codec 1"]
    assert threads["face 2"].isdisjoint(threads["codec 2"])
    assert len(alone) == len(beside) == len(repeated) == CHUNKS
    for one, two, three in zip(alone, beside, repeated, strict=True):
        assert one.face is not None
        for other in (two, three):
            np.testing.assert_array_equal(one.face, other.face)
            np.testing.assert_array_equal(one.rotations, other.rotations)


def test_two_threads_that_tick_at_once_do_not_wait_for_each_other(tiny_bundle: Path) -> None:
    pipeline = Pipeline(load_bundle(tiny_bundle))
    pipeline.warm_up()
    machine, both = Engine(pipeline, seats=2, workers=2), threading.Barrier(2)
    first, second = machine.open_core(), machine.open_core()

    def meet(stage: str) -> None:
        if stage == "level":
            both.wait(10)

    pipeline.on_stage = meet
    first.push(np.ones(6_400, np.float32))
    other = threading.Thread(target=machine.tick, daemon=True)
    other.start()
    while not both.n_waiting:
        time.sleep(0.001)
    second.push(np.ones(6_400, np.float32))
    last = threading.Thread(target=machine.tick, daemon=True)
    last.start()
    for thread in (other, last):
        thread.join(10)
        assert not thread.is_alive()
    assert first.made == second.made == 6_400


def test_a_fault_while_what_changed_is_kept_is_taken_back_too(monkeypatch: pytest.MonkeyPatch) -> None:
    faults, changes = [MemoryError("no room")], Rows.changes

    def failing(*given: Any) -> Patch:
        if faults:
            raise faults.pop()
        return changes(*given)

    monkeypatch.setattr(Rows, "changes", failing)
    machine = engine()
    session = machine.open()
    session.push(np.ones(6_400, np.float32))
    while machine.work():
        pass
    assert machine._rows.state.total.item() == 6_400  # type: ignore[attr-defined]
    assert len(list(session)) == 1


def test_a_pipeline_that_is_loaded_again_leaves_nothing_of_the_old_one_in_memory(tiny_bundle: Path) -> None:
    """At once, without Python's search for cycles, which may come minutes later or never: loaded objects are frozen."""
    engine = load(tiny_bundle, seats=1)
    parts = [engine.pipeline, engine.pipeline.generator, engine.pipeline.generator._step.__self__]
    tokenizer = engine.pipeline.decoder._step.__self__
    parts += [engine.pipeline.codec, tokenizer, *tokenizer.parameters()]
    old = [weakref.ref(part) for part in parts]
    del parts, tokenizer
    gc.disable()
    try:
        engine.restart()
        assert [known() for known in old] == [None] * len(old)
    finally:
        gc.enable()
