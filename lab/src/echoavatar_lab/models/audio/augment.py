"""Augmentation of training sound: a small codec must generalise to voices, music and rooms that are not in its data.

Two kinds. What changes the source (pitch, level) changes the target too; what changes the channel (equaliser, room,
band limit, noise) may be kept from the target, so that the codes learn to look through it.

May import `timing` only.
"""

from typing import NamedTuple

import numpy as np
import soxr
from jaxtyping import Float

from echoavatar.timing import SAMPLE_RATE_HZ

FloatArray = Float[np.ndarray, " s"]
_FFT = 65_536


class Pair(NamedTuple):
    """Input of the encoder and target of the decoder."""

    heard: FloatArray
    target: FloatArray


def source_samples(rng: np.random.Generator, samples: int) -> tuple[float, int]:
    """A resampling factor (pitch and formants move by it), and how many source samples it needs."""
    factor = float(np.exp(rng.uniform(np.log(0.8), np.log(1.25)))) if rng.random() < 0.7 else 1.0
    return factor, int(np.ceil(samples * factor)) + 64


def augment(rng: np.random.Generator, source: FloatArray, factor: float, samples: int) -> Pair:
    """One training pair of `samples` from a longer piece of sound; `factor` and length from `source_samples`."""
    if factor != 1.0:
        source = soxr.resample(source, SAMPLE_RATE_HZ * factor, SAMPLE_RATE_HZ, quality="MQ")
    source = _level(rng, source[:samples].astype(np.float32))
    clean_target = rng.random() < 0.5
    heard = _channel(rng, source) if rng.random() < 0.8 else source
    target = source if clean_target else heard
    if rng.random() < 0.5:
        heard = heard + _noise(rng, samples, heard)
    return Pair(np.clip(heard, -1, 1).astype(np.float32), np.clip(target, -1, 1).astype(np.float32))


def _level(rng: np.random.Generator, source: FloatArray) -> FloatArray:
    """Bring sound (not silence) to -23 dBFS with a spread of 6 dB, about as the level control would."""
    rms = float(np.sqrt(np.mean(np.square(source)) + 1e-12))
    if rms < 1e-3:
        return source
    wanted = 10 ** (rng.normal(-23, 6) / 20)
    return np.asarray(source * min(wanted / rms, 0.98 / max(float(np.abs(source).max()), 1e-6)), np.float32)


def _channel(rng: np.random.Generator, source: FloatArray) -> FloatArray:
    """Equaliser, band limit and room, multiplied in the frequency domain."""
    size = _FFT if len(source) <= _FFT // 2 else 1 << (2 * len(source) - 1).bit_length()
    frequency = np.fft.rfftfreq(size, 1 / SAMPLE_RATE_HZ)
    response = _equaliser(rng, frequency).astype(np.complex64)
    if rng.random() < 0.3:
        response *= 1 / np.sqrt(1 + (frequency / rng.uniform(3_000, 9_000)) ** 16)
    if rng.random() < 0.3:
        low = rng.uniform(60, 300)
        response *= (frequency / low) ** 2 / np.sqrt(1 + (frequency / low) ** 4)
    if rng.random() < 0.35:
        response *= np.fft.rfft(_room(rng), size)
    wet = np.fft.irfft(np.fft.rfft(source, size) * response, size)[: len(source)]
    power, before = np.mean(np.square(wet)), np.mean(np.square(source))
    return np.asarray(wet * np.sqrt((before + 1e-12) / (power + 1e-12)), np.float32)


def _equaliser(rng: np.random.Generator, frequency: FloatArray) -> FloatArray:
    """A tilt and three bells of up to 9 dB: rooms, microphones, other speakers."""
    octave = np.log2(np.maximum(frequency, 20) / 1_000)
    gain_db = rng.normal(0, 1.5) * octave
    for _ in range(3):
        centre, width = rng.uniform(-3, 3.3), rng.uniform(0.3, 1.2)
        gain_db = gain_db + rng.uniform(-9, 9) * np.exp(-(((octave - centre) / width) ** 2))
    return np.asarray(10 ** (np.clip(gain_db, -30, 15) / 20))


def _room(rng: np.random.Generator) -> FloatArray:
    """Direct sound and an exponential tail of noise (60 dB down after 0.15 to 0.6 s)."""
    length = SAMPLE_RATE_HZ // 2
    decay = np.exp(-6.9 * np.arange(length) / (SAMPLE_RATE_HZ * rng.uniform(0.15, 0.6)))
    tail = rng.standard_normal(length) * decay
    tail *= rng.uniform(0.1, 0.6) / np.sqrt(np.sum(np.square(tail)))
    tail[0] += 1
    return np.asarray(tail, np.float32)


def _noise(rng: np.random.Generator, samples: int, heard: FloatArray) -> FloatArray:
    """Coloured noise, 8 to 35 dB below the sound (or at -70 dBFS where there is none)."""
    spectrum = np.fft.rfft(rng.standard_normal(samples).astype(np.float32))
    spectrum *= (np.arange(len(spectrum)) + 20.0) ** (-rng.uniform(0, 1))
    noise = np.fft.irfft(spectrum, samples)
    level = max(float(np.sqrt(np.mean(np.square(heard)))), 10 ** (-45 / 20)) * 10 ** (-rng.uniform(8, 35) / 20)
    return np.asarray(noise * level / (np.sqrt(np.mean(np.square(noise))) + 1e-12), np.float32)
