"""Kaldi's log mel filter banks, the input of BEATs: 128 bands, 25 ms frames every 10 ms, audio at 16 kHz.

Only whole frames count. Each frame loses its mean, is pre-emphasised and weighted with Kaldi's own window, a Hann to
the power 0.85. No dither.
"""

from functools import cache

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

RATE_HZ = 16_000
BANDS = 128
FRAME, STEP = 400, 160
SPECTRUM = 512
PRE_EMPHASIS = 0.97
LOWEST_HZ = 20.0
MEAN, STD = 15.41663, 6.55582  # of BEATs' training audio; BEATs divides by twice the deviation
FULL_SCALE = 2.0**15


def fbank(wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t 128"]:
    """Log energies of the bands, normalised for BEATs; `wave` lies within -1 and 1."""
    frames = (wave * FULL_SCALE).unfold(1, FRAME, STEP)
    frames = frames - frames.mean(-1, keepdim=True)
    before = torch.cat([frames[..., :1], frames[..., :-1]], -1)
    window, bands = _window().to(wave), _bands().to(wave)
    power = torch.fft.rfft((frames - PRE_EMPHASIS * before) * window, n=SPECTRUM).abs().square()
    energies = power[..., : SPECTRUM // 2] @ bands
    logs: Tensor = energies.clamp(min=torch.finfo(torch.float32).eps).log()
    return (logs - MEAN) / (2 * STD)


def _mel(hertz: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    return 1127 * torch.log1p(hertz / 700)


@cache
def _window() -> Float[Tensor, " f"]:
    return torch.hann_window(FRAME, periodic=False, dtype=torch.float64) ** 0.85


@cache
def _bands() -> Float[Tensor, "k 128"]:
    """Triangular filters, two bands wide in mel; the Nyquist bin is left out, as in Kaldi."""
    low, high = (float(_mel(torch.tensor(hertz, dtype=torch.float64))) for hertz in (LOWEST_HZ, RATE_HZ / 2))
    width = (high - low) / (BANDS + 1)
    centres = low + width * torch.arange(1, BANDS + 1, dtype=torch.float64)
    bins = _mel(torch.arange(SPECTRUM // 2, dtype=torch.float64) * RATE_HZ / SPECTRUM)
    return F.relu(1 - (bins[:, None] - centres).abs() / width)
