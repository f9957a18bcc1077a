"""Streaming level control: quiet sound is lifted, silence stays silent, nothing clips.

Not in the paper. A gain that follows the loudest recent sound (so that the dynamics of music survive), a gate for
pauses, and a soft limiter. The gain is decided once per block of 160 samples, from that block and earlier ones. All
running sums are sums of integers, so any chunking gives the same bits.

May import `nn`, `timing` and `errors`.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.nn import StreamingModule, StreamState, write_rows
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN, SAMPLES_PER_FRAME

LEVEL_BLOCK_SAMPLES = math.gcd(SAMPLES_PER_FRAME, SAMPLES_PER_AUDIO_TOKEN)  # 160 samples, 6.7 ms
_WINDOW = 64  # blocks of the loudness window, 0.43 s
_PIECE = 60 * SAMPLE_RATE_HZ

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

    seen: Int[Tensor, " b"]  # blocks
    heard: Int[Tensor, " b"]  # blocks that held sound
    pause: Int[Tensor, " b"]  # blocks since the last sound
    floor_db: Float[Tensor, " b"]
    loudness_db: Float[Tensor, " b"]
    energies: Int[Tensor, "b w"]  # of the last blocks
    gain: Float[Tensor, " b"]  # at the last sample


class LevelControl(StreamingModule[LevelState]):
    """It has no weights and no settings, because the meaning of the codes depends on it."""

    def __init__(self) -> None:
        super().__init__()
        ramp = torch.arange(1, LEVEL_BLOCK_SAMPLES + 1, dtype=torch.float64) / LEVEL_BLOCK_SAMPLES
        self.register_buffer("ramp", ramp, persistent=False)

    ramp: Tensor

    def init_state(self, rows: int) -> LevelState:
        """A fresh state."""
        count = torch.zeros(rows, dtype=torch.int64, device=self.ramp.device)
        value = self.ramp.new_zeros(rows, dtype=torch.float64)
        energies = count.new_zeros(rows, _WINDOW - 1)
        return LevelState(count, count.clone(), count.clone(), value, value.clone(), energies, value.clone())

    @torch.no_grad()
    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b s"]:
        """A whole clip of any length: one run from a fresh state."""
        samples = x.shape[1]
        x = F.pad(x, (0, -samples % LEVEL_BLOCK_SAMPLES))
        state, active = self.init_state(len(x)), x.new_ones(len(x), dtype=torch.bool)
        parts = [self.step(part, state, active) for part in torch.split(x, _PIECE, dim=1) if part.shape[1]]
        return torch.cat([x[:, :0], *parts], dim=1)[:, :samples]

    @torch.no_grad()
    def step(self, x: Float[Tensor, "b s"], state: LevelState, active: Bool[Tensor, " b"]) -> Float[Tensor, "b s"]:
        """The next samples (a multiple of 160), same length out, no delay."""
        if x.shape[1] % LEVEL_BLOCK_SAMPLES or not x.shape[1]:
            raise ValueError(f"a step takes a multiple of {LEVEL_BLOCK_SAMPLES} samples, got {x.shape[1]}")
        blocks = x.double().reshape(len(x), -1, LEVEL_BLOCK_SAMPLES)
        energies = (blocks.clamp(-2, 2) * _RESOLUTION).round().square().sum(-1).long()
        before, fresh = state.gain.clone(), state.seen == 0
        gains = 10 ** (self._gain_db(energies, state, active) / 20)
        before = torch.where(fresh, gains[:, 0], before)
        starts = torch.cat([before[:, None], gains[:, :-1]], dim=1)
        curve = starts[..., None] + (gains - starts)[..., None] * self.ramp
        write_rows(state.gain, gains[:, -1], active)
        return _limit(blocks * curve).flatten(1).to(x.dtype)

    def _gain_db(
        self, energies: Int[Tensor, "b k"], state: LevelState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b k"]:
        """Gain at the end of each block; `state` moves on."""
        level = _level_db(energies, 1)
        index = torch.arange(1, energies.shape[1] + 1, device=energies.device)
        floor = self._floor_db(level, index, state)
        is_sound = (level > _FAINTEST_DB) & ((level > floor + _ABOVE_FLOOR_DB) | (level > _SURELY_SOUND_DB))
        recent = torch.cat([state.energies, energies], dim=1)
        sums = F.pad(recent.cumsum(1), (1, 0))
        seen = (state.seen[:, None] + index).clamp(max=_WINDOW)
        window = _level_db(sums[:, _WINDOW:] - sums[:, :-_WINDOW], seen)
        heard = state.heard[:, None] + is_sound.cumsum(1)
        loudness = self._loudness_db(torch.maximum(window, level - 3), is_sound, heard, state)
        last_sound = torch.where(is_sound, index, 0).cummax(1).values
        pause = torch.where(last_sound > 0, index - last_sound, state.pause[:, None] + index)
        gain = torch.where(heard > 0, (_TARGET_DB - loudness).clamp(*_GAIN_DB), 0.0)
        gate = ((pause - _HOLD_BLOCKS) * _GATE_STEP_DB).clamp(0, _GATE_DB)
        write_rows(state.energies, recent[:, -(_WINDOW - 1) :], active)
        write_rows(state.floor_db, floor[:, -1], active)
        write_rows(state.loudness_db, loudness[:, -1], active)
        write_rows(state.heard, heard[:, -1], active)
        write_rows(state.pause, pause[:, -1], active)
        write_rows(state.seen, state.seen + len(index), active)
        return gain - gate

    def _floor_db(self, level: Tensor, index: Tensor, state: LevelState) -> Float[Tensor, "b k"]:
        """The recursion floor = min(floor + rise, level), unrolled: the rise is taken off before a running minimum."""
        before = torch.where(state.seen > 0, state.floor_db, math.inf)[:, None]
        slope = index * _FLOOR_RISE_DB
        lowest = torch.cat([before, level - slope], dim=1).cummin(1).values[:, 1:]
        return lowest + slope

    def _loudness_db(self, level: Tensor, is_sound: Tensor, heard: Tensor, state: LevelState) -> Float[Tensor, "b k"]:
        """Where there is sound, loudness = max(loudness - decay, level); unrolled in the same way."""
        before = torch.where(state.heard > 0, state.loudness_db, -math.inf)[:, None]
        slope = (heard - state.heard[:, None]) * _DECAY_DB
        candidates = torch.where(is_sound, level + slope, -math.inf)
        highest = torch.cat([before, candidates], dim=1).cummax(1).values[:, 1:]
        return torch.where(heard > 0, highest - slope, 0.0)


def _level_db(energy: Int[Tensor, "b k"], blocks: Tensor | int) -> Float[Tensor, "b k"]:
    """RMS in dBFS over this many blocks, in integer steps of 1/1024 dB, at least -100."""
    power = energy.double() / (blocks * LEVEL_BLOCK_SAMPLES * _RESOLUTION**2)
    return (10 * torch.log10(power.clamp_min(1e-10)) * 1024).round() / 1024


def _limit(x: Float[Tensor, "b k n"]) -> Float[Tensor, "b k n"]:
    """Unchanged up to the knee, then bent smoothly towards 1."""
    size = x.abs()
    bent = 1 - (1 - _KNEE) ** 2 / (size - _KNEE + (1 - _KNEE)).clamp_min(1e-9)
    return torch.where(size > _KNEE, x.sign() * bent, x)
