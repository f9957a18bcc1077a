"""Streaming level control: quiet sound is lifted, silence stays silent, nothing clips.

Not in the paper. A gain that follows the loudest recent sound (so that the dynamics of music survive), a gate for
pauses, and a soft limiter. The gain is decided once per block of 160 samples, from that block and earlier ones, so any
chunking gives the same bits.

May import `nn`, `timing` and `errors`.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel
from echoavatar.timing import SAMPLES_PER_AUDIO_TOKEN, SAMPLES_PER_FRAME

LEVEL_BLOCK_SAMPLES = math.gcd(SAMPLES_PER_FRAME, SAMPLES_PER_AUDIO_TOKEN)  # 160 samples, 6.7 ms
_WINDOW = 64  # blocks of the loudness window, 0.43 s

_TARGET_DB = -21.0  # RMS of the loudest recent 0.43 s
_GAIN_DB = (-30.0, 36.0)
_DECAY_DB = 5 / 1024  # per active block: 0.73 dB per second until a soft passage becomes the new loudness
_FLOOR_RISE_DB = 20 / 1024  # per block: 2.9 dB per second until a steady noise becomes the floor
_FAINTEST_DB = -60.0  # never lifted below this
_SURELY_SOUND_DB = -40.0  # always sound above this
_ABOVE_FLOOR_DB = 8.0  # in between: sound if this far over the noise floor
_HOLD_BLOCKS = 38  # 0.25 s of pause before the gate closes
_GATE_STEP_DB = 0.3
_GATE_DB = 18.0
_KNEE = 0.7  # where the limiter begins to bend
_RESOLUTION = 2.0**18  # samples are measured (not altered) in whole steps of this


@dataclass
class LevelState(StreamState):
    """All zero: nothing was heard yet."""

    seen: Int[np.ndarray, " b"]  # blocks so far
    heard: Int[np.ndarray, " b"]  # blocks that held sound
    pause: Int[np.ndarray, " b"]  # blocks since the last sound
    floor_db: Float[np.ndarray, " b"]
    loudness_db: Float[np.ndarray, " b"]
    energies: Int[np.ndarray, "b w"]  # of the last blocks; block k lies in slot k mod w
    gain: Float[np.ndarray, " b"]  # at the last sample


@kernel()
def _level_db(energy, blocks):  # type: ignore[no-untyped-def]
    """RMS in dBFS over this many blocks, in integer steps of 1/1024 dB, at least -100."""
    power = energy / (blocks * LEVEL_BLOCK_SAMPLES * _RESOLUTION**2)
    return np.rint(10 * math.log10(max(power, 1e-10)) * 1024) / 1024


@kernel()
def _limit(x):  # type: ignore[no-untyped-def]
    """Unchanged up to the knee, then bent smoothly towards 1."""
    size = abs(x)
    if size <= _KNEE:
        return x
    return math.copysign(1 - (1 - _KNEE) ** 2 / (size - _KNEE + (1 - _KNEE)), x)


@kernel()
def _gain_db(energy, row, seen, heard, pause, floor_db, loudness_db, energies):  # type: ignore[no-untyped-def]
    """Gain at the end of the next block of a row, whose state moves on."""
    energies[row, seen[row] % _WINDOW] = energy
    seen[row] += 1
    level = _level_db(energy, 1)
    floor_db[row] = min(floor_db[row] + _FLOOR_RISE_DB, level) if seen[row] > 1 else level
    pause[row] += 1
    if level > max(_FAINTEST_DB, min(floor_db[row] + _ABOVE_FLOOR_DB, _SURELY_SOUND_DB)):
        loudness = max(_level_db(energies[row].sum(), min(seen[row], _WINDOW)), level - 3)
        loudness_db[row] = max(loudness_db[row] - _DECAY_DB, loudness) if heard[row] else loudness
        heard[row] += 1
        pause[row] = 0
    lift = min(max(_TARGET_DB - loudness_db[row], _GAIN_DB[0]), _GAIN_DB[1]) if heard[row] else 0.0
    return lift - min(max((pause[row] - _HOLD_BLOCKS) * _GATE_STEP_DB, 0.0), _GATE_DB)


@kernel()
def _run(x, rows, seen, heard, pause, floor_db, loudness_db, energies, gain):  # type: ignore[no-untyped-def]
    """Control the chosen rows of x (b, s), in place."""
    for row in rows:
        for first in range(0, x.shape[1], LEVEL_BLOCK_SAMPLES):
            energy = 0.0  # a sum of whole numbers
            for i in range(first, first + LEVEL_BLOCK_SAMPLES):
                energy += np.rint(min(max(x[row, i], -2.0), 2.0) * _RESOLUTION) ** 2
            decibels = _gain_db(np.int64(energy), row, seen, heard, pause, floor_db, loudness_db, energies)
            after = 10 ** (decibels / 20)
            before = gain[row] if seen[row] > 1 else after
            for i in range(LEVEL_BLOCK_SAMPLES):
                now = before + (after - before) * ((i + 1) / LEVEL_BLOCK_SAMPLES)
                x[row, first + i] = _limit(x[row, first + i] * now)
            gain[row] = after


class LevelControl:
    """Level control without weights or settings, because the meaning of the codes depends on it."""

    def init_state(self, rows: int) -> LevelState:
        """A fresh state."""
        seen, heard, pause = np.zeros((3, rows), np.int64)
        floor_db, loudness_db, gain = np.zeros((3, rows))
        return LevelState(seen, heard, pause, floor_db, loudness_db, np.zeros((rows, _WINDOW), np.int64), gain)

    def __call__(self, x: Float[np.ndarray, "b s"]) -> Float[np.ndarray, "b s"]:
        """A whole clip of any length: one run from a fresh state."""
        padded = np.pad(x, ((0, 0), (0, -x.shape[1] % LEVEL_BLOCK_SAMPLES)))
        if not padded.size:
            return padded
        heard = self.step(padded, self.init_state(len(x)), np.ones(len(x), np.bool_))
        return np.asarray(heard[:, : x.shape[1]])

    def step(
        self, x: Float[np.ndarray, "b s"], state: LevelState, active: Bool[np.ndarray, " b"]
    ) -> Float[np.ndarray, "b s"]:
        """The next samples, without delay; inactive rows are unchanged. ValueError: not a multiple of 160 samples."""
        if x.shape[1] % LEVEL_BLOCK_SAMPLES or not x.shape[1]:
            raise ValueError(f"a step takes a multiple of {LEVEL_BLOCK_SAMPLES} samples, got {x.shape[1]}")
        y = x.copy()
        _run(y, np.flatnonzero(active), *vars(state).values())
        return y
