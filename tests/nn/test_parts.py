import threading
from collections.abc import Iterator

import pytest
import torch

from echoavatar.nn.parts import Parts


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
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
            assert parts.map(work, cut) == [(part.start, *seen) for part in cut]


def test_an_error_in_a_part_reaches_the_caller(threads: int) -> None:
    parts = Parts("test", least=1)

    def work(part: slice) -> None:
        if part.stop == 6:
            raise ValueError("of the last part")

    with pytest.raises(ValueError, match="last part"):
        parts.map(work, parts.of(6))
