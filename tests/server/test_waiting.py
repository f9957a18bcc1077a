import pytest

from echoavatar.server import waiting
from echoavatar.server.waiting import MOST, PATIENCE_S, RETRY_S, WaitingList


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(waiting.time, "monotonic", lambda: now[0])
    return now


def test_who_came_first_is_first_and_moves_up_when_one_leaves(clock: list[float]) -> None:
    queue = WaitingList()
    assert [queue.place(ticket) for ticket in "abc"] == [1, 2, 3]
    assert queue.place("b") == 2
    queue.leave("a")
    assert queue.place("b") == 1
    assert queue.place("") == 3  # without a ticket: behind all


def test_who_does_not_come_back_in_time_has_left(clock: list[float]) -> None:
    queue = WaitingList()
    queue.place("gone")
    for _ in range(5):
        clock[0] += RETRY_S
        place = queue.place("patient")
    assert place == 1
    clock[0] += PATIENCE_S
    assert queue.place("patient") == 1
    assert queue.place("gone") == 2


def test_the_queue_has_an_end(clock: list[float]) -> None:
    queue = WaitingList()
    for number in range(MOST):
        queue.place(str(number))
    assert queue.place("late") == queue.place("later") == MOST + 1
    assert queue.place("7") == 8
