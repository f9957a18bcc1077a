"""A flash and a beep at the same moment, and where they are in what was seen and heard."""

from typing import Any

import numpy as np
import torch
from tests.engine.fakes import Heard
from tests.server.fakes import Body

from echoavatar.motion.motion_chunk import MotionChunk

FRAME = 800
PERIOD = 27 * FRAME  # from flash to flash: 0.9 s, no multiple of a picture's 40 ms
FLASH = 9 * FRAME  # 0.3 s
AWAY_M = 6.0  # a body so far above is out of the picture


class Flasher(Body):
    """The body leaves the picture, which is then brighter, in frames whose first samples sound."""

    def step(self, audio: torch.Tensor, state: Heard, active: torch.Tensor) -> Any:
        made = []
        for row in audio.numpy():
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


def middles(times: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Middles of the complete runs above a half; a run begins and ends halfway between two times."""
    edges = np.flatnonzero(np.diff((share > 0.5).astype(int)))
    turns = (times[edges] + times[edges + 1]) / 2
    first = int(share[0] > 0.5)  # a run that had begun before
    return np.array([(start + stop) / 2 for start, stop in zip(turns[first::2], turns[first + 1 :: 2], strict=False)])
