import gc
import threading
import time
import weakref
from collections.abc import Iterator
from functools import partial

import pytest
import torch

from echoavatar.nn.parts import Parts


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    yield from _torch_threads(request.param)


@pytest.fixture
def two_threads() -> Iterator[int]:
    yield from _torch_threads(2)


def _torch_threads(count: int) -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    yield count
    torch.set_num_threads(before)


def test_parts_cover_every_row_once_and_are_no_more_than_threads(threads: int) -> None:
    parts = Parts("test", least=4)
    for rows in (1, 4, 11, 64):
        cut = parts.of(rows)
        assert [row for part in cut for row in range(rows)[part]] == list(range(rows))
        assert len(cut) == min(threads, max(1, rows // 4))


def test_every_part_is_worked_in_one_thread_and_the_callers_mode(threads: int) -> None:
    parts, waiting = Parts("test", least=1), threading.Barrier(threads, timeout=20)

    def work(part: slice) -> tuple[int, bool, bool, int]:
        waiting.wait()  # all at the same time
        return part.start, torch.is_inference_mode_enabled(), torch.is_grad_enabled(), torch.get_num_threads()

    for mode in (torch.inference_mode, torch.no_grad, torch.enable_grad):
        with mode():
            cut = parts.of(threads)
            seen = (torch.is_inference_mode_enabled(), torch.is_grad_enabled(), 1)
            assert parts.run([partial(work, part) for part in cut]) == [(part.start, *seen) for part in cut]
            assert torch.get_num_threads() == threads


def test_an_error_in_a_part_reaches_the_caller_when_all_are_done(threads: int) -> None:
    parts, done = Parts("test", least=1), list[int]()

    def work(part: slice) -> None:
        if part.stop == 6:
            raise ValueError("of the last part")
        time.sleep(0.05)
        done.append(part.start)

    with pytest.raises(ValueError, match="last part"):
        parts.run([partial(work, part) for part in parts.of(6)])
    assert len(done) == threads - 1
    assert torch.get_num_threads() == threads


def test_an_error_in_the_first_part_waits_for_the_others(two_threads: int) -> None:
    parts, begun, done = Parts("test", least=1), threading.Event(), list[int]()

    def fail() -> None:
        assert begun.wait(20)
        raise ValueError("of the first part")

    def go_on() -> None:
        begun.set()
        time.sleep(0.2)
        done.append(1)

    with pytest.raises(ValueError, match="first part"):
        parts.run([fail, go_on])
    assert done == [1]


def test_who_calls_does_not_wait_for_a_thread_that_is_busy(two_threads: int) -> None:
    parts, begun, go_on = Parts("test", least=1), threading.Event(), threading.Event()
    made, slow = list[int](), list[list[None]]()

    def hold() -> None:
        begun.set()
        assert go_on.wait(20)

    def other() -> None:  # whose last part keeps the second thread
        torch.set_num_threads(2)
        slow.append(parts.run([partial(begun.wait, 20), hold]))  # type: ignore[list-item]

    caller = threading.Thread(target=other)
    caller.start()
    assert begun.wait(20)
    calls = [partial(made.append, number) for number in range(4)]
    assert parts.run(calls) == [None] * 4
    assert made == [0, 1, 2, 3]
    assert caller.is_alive()
    assert not slow
    go_on.set()
    caller.join(20)
    assert len(slow) == 1
    assert parts.run([partial(made.append, 4), partial(made.append, 5)]) == [None] * 2
    assert sorted(made) == [0, 1, 2, 3, 4, 5]  # none twice, now that the second thread has seen them all


def test_threads_end_with_their_parts_and_hold_nothing(two_threads: int) -> None:
    parts = Parts("ending", least=1)
    big = torch.zeros(3)
    kept = weakref.ref(big)
    parts.run([partial(torch.sum, big), partial(torch.sum, big)])
    assert _threads("ending") == 1
    del big
    _until(lambda: kept() is None)
    del parts
    gc.collect()
    _until(lambda: _threads("ending") == 0)


def _threads(name: str) -> int:
    return sum(thread.name.startswith(name) for thread in threading.enumerate())


def _until(is_so) -> None:  # type: ignore[no-untyped-def]
    until = time.monotonic() + 20
    while not is_so():
        assert time.monotonic() < until
        time.sleep(0.01)
