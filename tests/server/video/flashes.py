"""A flash and a beep at the same moment, and where they are in what was seen and heard."""

from typing import Any

import numpy as np
import pytest
from tests.engine.fakes import Heard
from tests.server.fakes import Body

from echoavatar.motion.motion_chunk import MotionChunk

FRAME = 800
PERIOD = 27 * FRAME  # from flash to flash: 0.9 s, no multiple of a picture's 40 ms
FLASH = 9 * FRAME  # 0.3 s
AWAY_M = 6.0  # a body so far above is out of the picture


class Flasher(Body):
    """The body leaves the picture, which is then brighter, in frames whose first samples sound."""

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> Any:
        made = []
        for row in audio:
            loud = np.abs(row.reshape(-1, FRAME)[:, :100]).max(1) > 0.05
            root = np.zeros((len(loud), 3), np.float32)
            root[:, 1] = np.where(loud, AWAY_M, 0.9)
            made.append(MotionChunk(np.tile(np.float32([1, 0, 0, 0]), (len(loud), 52, 1)), root))
        return made


def beeps(count: int) -> np.ndarray:
    """Beeps whose middle is that of the frames that begin in them."""
    samples = np.zeros(count * PERIOD + PERIOD, np.float32)
    tone = 0.5 * np.sin(2 * np.pi * 1_000 * np.arange(FLASH) / 24_000).astype(np.float32)
    for index in range(count):
        start = PERIOD // 2 // FRAME * FRAME + FRAME // 2 + index * PERIOD
        samples[start : start + FLASH] = tone
    return samples


def runs(times: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the complete runs above a half, and how far off each may be.

    A run begins and ends somewhere between two times; halfway is taken.
    """
    edges = np.flatnonzero(np.diff((share > 0.5).astype(int)))
    edges = edges[int(share[0] > 0.5) :]  # without a run that had begun before
    edges = edges[: len(edges) // 2 * 2].reshape(-1, 2)
    turns, halves = (times[edges] + times[edges + 1]) / 2, (times[edges + 1] - times[edges]) / 2
    return turns.mean(1), halves.mean(1)


def middles(times: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Middles of the complete runs above a half."""
    return runs(times, share)[0]


def judge_mean(offsets: np.ndarray, bound: float) -> None:
    """Fail where the mean is outside the bound by more than chance: two standard errors.

    Offsets on the wall clock scatter with the machine's load; where they tell nothing, the test skips.
    """
    error = 2 * offsets.std(ddof=1) / len(offsets) ** 0.5
    if error > bound:
        pytest.skip(f"flashes scatter too much to be judged: a mean is known to {1e3 * error:.0f} ms")
    assert abs(offsets.mean()) < bound + error, offsets
