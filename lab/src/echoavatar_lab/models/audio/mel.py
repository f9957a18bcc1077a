"""Mel spectra, for training and judging the codec."""

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar_lab.models.face.encoder import mel_matrix


def mel_spectrum(audio: Float[Tensor, "b s"], *, fft: int, hop: int, bands: int) -> Float[Tensor, "b t m"]:
    """Mel magnitudes, 1.0 for a full-scale sine in its band's middle at most; t = s // hop + 1, centred frames."""
    window = torch.hann_window(fft, device=audio.device, dtype=audio.dtype)
    spectrum = torch.stft(audio, fft, hop, window=window, return_complex=True, pad_mode="constant")
    magnitude = torch.sqrt(spectrum.real.square() + spectrum.imag.square() + 1e-12) * (2 / fft)
    return magnitude.transpose(1, 2) @ mel_matrix(fft, bands).to(audio)


def log_mel(audio: Float[Tensor, "b s"], *, fft: int, hop: int, bands: int) -> Float[Tensor, "b t m"]:
    """Natural logarithm of `mel_spectrum`, floored at 1e-5 (softly)."""
    return torch.log(mel_spectrum(audio, fft=fft, hop=hop, bands=bands) + 1e-5)
