import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.errors import EchoAvatarError


def test_seats_are_taken_freed_and_refused() -> None:
    machine = engine(seats=2)
    first, second = machine.open(), machine.open()
    with pytest.raises(EchoAvatarError, match="all 2 seats are taken"):
        machine.open()
    first.close()
    first.close()  # closing twice frees one seat only
    third = machine.open(seed=5)
    assert third.seat == first.seat != second.seat


def test_a_new_session_does_not_remember_the_last_one_on_its_seat() -> None:
    machine = engine()
    with machine.open() as session:
        session.push(np.ones(6_400, np.float32))
        assert len(list(session)) == 1
    with machine.open(seed=5) as session:
        session.push(np.zeros(6_400, np.float32))
        assert float(next(iter(session)).root[0, 0]) == 5


def test_one_tick_moves_every_waiting_session_and_nobody_else() -> None:
    machine = engine(seats=3)
    sessions = [machine.open() for _ in range(3)]
    sessions[0].push(np.ones(12_800, np.float32))
    sessions[2].push(np.full(6_400, 2, np.float32))
    assert machine.tick() == 2
    assert machine.tick() == 1
    assert machine.tick() == 0
    totals = [[float(chunk.root[0, 0]) for chunk in session] for session in sessions]
    assert totals == [[6_400, 12_800], [], [12_800]]


def test_no_seats_is_refused() -> None:
    with pytest.raises(EchoAvatarError, match="at least one seat"):
        engine(seats=0)
