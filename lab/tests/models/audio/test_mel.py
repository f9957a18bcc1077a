import numpy as np
import torch

from echoavatar_lab.models.audio.mel import log_mel, mel_spectrum
from echoavatar_lab.models.face.encoder import mel_matrix


def test_every_filter_is_used_and_sums_to_one():
    for fft, bands in ((2048, 80), (512, 48), (256, 24), (512, 64)):
        torch.testing.assert_close(mel_matrix(fft, bands).sum(0), torch.ones(bands))


def test_a_sine_peaks_in_the_band_of_its_frequency():
    """1 kHz is 1,000 mel; 12 kHz is 3,265; of 80 bands the middle at 1,000 is number 1000 / 3265 * 81 - 1 = 23.8."""
    tone = torch.from_numpy(np.sin(2 * np.pi * 1_000 * np.arange(24_000) / 24_000)).float()[None]
    peak = int(mel_spectrum(tone, fft=1024, hop=256, bands=80)[0, 40].argmax())
    assert peak in (23, 24)


def test_silence_is_the_floor_and_louder_is_more():
    quiet = log_mel(torch.zeros(1, 6_400), fft=512, hop=80, bands=64)
    assert quiet.shape == (1, 81, 64)
    assert (quiet < -11).all()
    noise = torch.randn(1, 6_400)
    difference = log_mel(noise, fft=512, hop=80, bands=64) - log_mel(noise / 10, fft=512, hop=80, bands=64)
    assert abs(float(difference.mean()) - np.log(10)) < 0.05
