"""Memory that is free goes back, also from between blocks that are in use."""

import platform
import resource
from pathlib import Path

import numpy as np
import pytest

from echoavatar.server import memory


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps what is freed")
def test_free_pages_between_blocks_in_use_go_back() -> None:
    blocks = [np.ones(12_000, np.uint8) for _ in range(10_000)]
    kept = blocks[::5]
    before = resident()
    del blocks
    memory.give_back()
    assert before - resident() > 40e6
    assert len(kept) == 2_000


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    memory._trim.cache_clear()
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda name: object())
    memory.give_back()
    memory._trim.cache_clear()


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
