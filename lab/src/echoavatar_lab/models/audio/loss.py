"""Losses of the small codec: mel spectra at several scales, the waveform, and a readout of the codes.

May import `mel` and `timing`.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.nn.mel import log_mel, mel_spectrum
from echoavatar.timing import SAMPLES_PER_AUDIO_TOKEN, exact_div

_SCALES = ((2048, 512, 80), (1024, 256, 80), (512, 128, 48), (256, 64, 24))  # FFT, hop, bands
_PROBE_STEPS = 4  # mel frames per latent frame: 300 Hz, fine enough for onsets
_PROBE_BANDS = 64


class SpectrumProbe(nn.Module):
    """Reads log-mel spectra off the quantised latents; used in training only.

    It makes the codes carry what motion depends on (onsets, loudness, timbre, pitch region) and is much cheaper than
    the decoder. EnCodec has an adversary in its place.
    """

    def __init__(self, *, width: int, hidden: int = 192) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv1d(width, hidden, 5, padding=2),
            nn.ELU(),
            nn.Conv1d(hidden, _PROBE_STEPS * _PROBE_BANDS, 3, padding=1),
        )
        nn.init.constant_(self.layers[-1].bias, -8.0)  # type: ignore[arg-type]  # the logarithm of soft sound

    def forward(self, latents: Float[Tensor, "b n c"]) -> Float[Tensor, "b t m"]:
        """Predicted log-mel, t = 4 n."""
        out = self.layers(latents.transpose(1, 2)).transpose(1, 2)
        return out.reshape(len(latents), -1, _PROBE_BANDS)  # type: ignore[no-any-return]

    def target(self, audio: Float[Tensor, "b s"]) -> Float[Tensor, "b t m"]:
        """The target of `forward`, t = 4 s / 320."""
        hop = exact_div(SAMPLES_PER_AUDIO_TOKEN, _PROBE_STEPS)
        return log_mel(audio, fft=512, hop=hop, bands=_PROBE_BANDS)[:, :-1]


class SoundLoss(NamedTuple):
    """Each term averaged over its elements."""

    log_mel: Float[Tensor, ""]
    mel: Float[Tensor, ""]
    waveform: Float[Tensor, ""]


def sound_loss(made: Float[Tensor, "b s"], wanted: Float[Tensor, "b s"]) -> SoundLoss:
    """Distance of two sounds, absolute differences throughout; mel terms are means over four window sizes."""
    logs, linears = [], []
    for fft, hop, bands in _SCALES:
        ours = mel_spectrum(made, fft=fft, hop=hop, bands=bands)
        theirs = mel_spectrum(wanted, fft=fft, hop=hop, bands=bands)
        logs.append((torch.log(ours + 1e-5) - torch.log(theirs + 1e-5)).abs().mean())
        linears.append((ours - theirs).abs().mean())
    return SoundLoss(torch.stack(logs).mean(), torch.stack(linears).mean(), (made - wanted).abs().mean())
