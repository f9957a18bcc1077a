"""Mel spectra, for training and judging the codec.

May import `timing` only.
"""

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.timing import SAMPLE_RATE_HZ


@lru_cache(maxsize=16)
def mel_matrix(fft: int, bands: int) -> Float[Tensor, "f m"]:
    """Triangular filters, equal steps on the mel scale (2595 log10(1 + f / 700)) up to 12 kHz, each of sum 1."""
    top = 2595 * torch.log10(torch.tensor(1 + SAMPLE_RATE_HZ / 2 / 700, dtype=torch.float64))
    edges = 700 * (10 ** (torch.linspace(0, 1, bands + 2, dtype=torch.float64) * top / 2595) - 1)
    bins = torch.linspace(0, SAMPLE_RATE_HZ / 2, fft // 2 + 1, dtype=torch.float64)[:, None]
    low, middle, high = edges[:-2], edges[1:-1], edges[2:]
    width = SAMPLE_RATE_HZ / fft  # narrow filters are widened to one bin, so that none is empty
    rise = (bins - low + width) / (middle - low + width)
    fall = (high + width - bins) / (high - middle + width)
    filters = torch.minimum(rise, fall).clamp_min(0)
    return (filters / filters.sum(0)).float()


def mel_spectrum(audio: Float[Tensor, "b s"], *, fft: int, hop: int, bands: int) -> Float[Tensor, "b t m"]:
    """Mel magnitudes, 1.0 for a full-scale sine in its band's middle at most; t = s // hop + 1, centred frames."""
    window = torch.hann_window(fft, device=audio.device, dtype=audio.dtype)
    spectrum = torch.stft(audio, fft, hop, window=window, return_complex=True, pad_mode="constant")
    magnitude = torch.sqrt(spectrum.real.square() + spectrum.imag.square() + 1e-12) * (2 / fft)
    return magnitude.transpose(1, 2) @ mel_matrix(fft, bands).to(audio)


def log_mel(audio: Float[Tensor, "b s"], *, fft: int, hop: int, bands: int) -> Float[Tensor, "b t m"]:
    """Natural logarithm of `mel_spectrum`, floored at 1e-5 (softly)."""
    return torch.log(mel_spectrum(audio, fft=fft, hop=hop, bands=bands) + 1e-5)
