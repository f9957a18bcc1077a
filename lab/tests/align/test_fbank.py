"""Filter banks: Kaldi's own numbers, and how many frames there are."""

import math

import numpy as np
import pytest
import torch

from echoavatar_lab.align.fbank import MEAN, STD, fbank

KALDI = {
    (0, 0): 14.94371509552002,
    (0, 20): 18.58997344970703,
    (3, 40): 6.724812984466553,
    (10, 64): 3.9602608680725098,
    (22, 100): 4.747962474822998,
}
"""kaldi-native-fbank 1.22.3 (128 bins, Povey window, no dither) of the sound below, by frame and band."""


def sound() -> torch.Tensor:
    n = np.arange(4000)
    wave = 0.3 * np.sin(2 * np.pi * 440 * n / 16000) + 0.1 * np.sin(2 * np.pi * 3000 * n / 16000 + 1)
    return torch.from_numpy(wave + 0.05 * np.sin(n * n / 9000))[None]


def test_bands_are_kaldis():
    found = fbank(sound())[0] * 2 * STD + MEAN
    for place, wanted in KALDI.items():
        assert found[place].item() == pytest.approx(wanted, abs=1e-3)


def test_only_whole_frames_count():
    lengths = {400: 1, 559: 1, 560: 2, 64_000: 398}
    assert {samples: fbank(torch.zeros(1, samples)).shape[1] for samples in lengths} == lengths


def test_silence_is_the_floor():
    floor = (math.log(torch.finfo(torch.float32).eps) - MEAN) / (2 * STD)
    torch.testing.assert_close(fbank(torch.zeros(1, 800)), torch.full((1, 3, 128), floor))
