"""Audio augmentation that keeps every label valid: rooms, equalisers, noise, level, band filling.

All filters are causal and begin with the direct sound, so nothing moves in time. Not in the paper.
"""

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, fftconvolve, lfilter, sosfilt

from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray

_PEAK = 0.89  # -1 dBFS


def loudness(audio: FloatArray) -> float:
    """Approximate loudness in LUFS: high-pass, 400 ms blocks, blocks more than 15 dB below the mean are ignored."""
    block = round(0.4 * SAMPLE_RATE_HZ)
    weighted = sosfilt(butter(2, 80, "highpass", fs=SAMPLE_RATE_HZ, output="sos"), audio)
    count = max(1, len(weighted) // block)
    power = np.array([float(np.mean(part**2)) for part in np.array_split(weighted, count)]) + 1e-12
    mean = float(np.mean(power))
    return float(10 * np.log10(np.mean(power[power > mean / 30]))) - 0.7


def set_loudness(audio: FloatArray, target_db: float) -> FloatArray:
    """Scale to a loudness (dB, about LUFS); peaks are compressed to stay below -1 dBFS."""
    level = loudness(audio)
    if level < -100:
        return audio
    scaled = audio * 10 ** ((target_db - level) / 20)
    over = np.abs(scaled) > 0.7
    soft = np.sign(scaled) * (0.7 + (_PEAK - 0.7) * np.tanh((np.abs(scaled) - 0.7) / (_PEAK - 0.7)))
    return np.asarray(np.where(over, soft, scaled), dtype=np.float32)


def fill_band(audio: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Fill 7.6-11.5 kHz with noise that follows the 5-7.5 kHz envelope, as 16 kHz speech lacks that band."""
    sides = butter(4, (5000, 7500), "bandpass", fs=SAMPLE_RATE_HZ, output="sos")
    top = butter(4, (7600, 11_500), "bandpass", fs=SAMPLE_RATE_HZ, output="sos")
    envelope = lfilter([0.02], [1, -0.98], np.abs(sosfilt(sides, audio)))
    noise = sosfilt(top, rng.standard_normal(len(audio)))
    return np.asarray(audio + 0.85 * envelope * noise, dtype=np.float32)


def equalise(audio: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Apply three random peaking filters of up to +-6 dB."""
    out: npt.NDArray[np.float64] = audio.astype(np.float64)
    for _ in range(3):
        hertz = float(np.exp(rng.uniform(np.log(90), np.log(8000))))
        b, a = _peaking(hertz, float(rng.uniform(-6, 6)), float(rng.uniform(0.5, 1.5)))
        out = lfilter(b, a, out)
    return np.asarray(out, dtype=np.float32)


def _peaking(hertz: float, db: float, quality: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Coefficients of a second-order peaking filter (bilinear transform of the analogue one)."""
    angle = 2 * np.pi * hertz / SAMPLE_RATE_HZ
    gain, slope = 10 ** (db / 40), np.sin(angle) / (2 * quality)
    b = np.array([1 + slope * gain, -2 * np.cos(angle), 1 - slope * gain])
    a = np.array([1 + slope / gain, -2 * np.cos(angle), 1 - slope / gain])
    return b / a[0], a / a[0]


def place_in_room(audio: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Add a synthetic room: decaying noise after the direct sound, reverberation time 0.15-0.6 s."""
    reverberation_s = float(rng.uniform(0.15, 0.6))
    time = np.arange(round(reverberation_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    tail = rng.standard_normal(len(time)) * np.exp(-6.9 * time / reverberation_s)
    tail[: round(0.004 * SAMPLE_RATE_HZ)] = 0
    tail = lfilter([1 - 0.35], [1, -0.35], tail)
    tail *= 10 ** (-rng.uniform(2, 14) / 20) / np.sqrt(np.sum(tail**2))
    tail[0] = 1.0
    return np.asarray(fftconvolve(audio, tail)[: len(audio)], dtype=np.float32)


def background(rng: np.random.Generator, samples: int) -> FloatArray:
    """Noise (samples,) of unit RMS: a room (brownish), air (pinkish), hiss, or hum of the mains with harmonics."""
    kind = str(rng.choice(["room", "air", "hiss", "hum"]))
    if kind == "hum":
        time = np.arange(samples) / SAMPLE_RATE_HZ
        base = float(rng.choice([50.0, 60.0]))
        noise = 0.1 * rng.standard_normal(samples)
        for order in (1, 2, 3, 5, 7):
            noise = noise + rng.uniform(0.2, 1) / order * np.sin(2 * np.pi * (base * order * time + rng.random()))
    else:
        pole = {"room": 0.985, "air": 0.8, "hiss": 0.0}[kind]
        noise = lfilter([1], [1, -pole], rng.standard_normal(samples))
    return (noise / max(float(np.sqrt(np.mean(noise**2))), 1e-9)).astype(np.float32)


def add_background(audio: FloatArray, rng: np.random.Generator, snr_db: float) -> FloatArray:
    """Add noise of a random kind throughout, `snr_db` below the loud parts."""
    noise = background(rng, len(audio))
    level = 10 ** ((loudness(audio) - snr_db) / 20)
    return np.asarray(audio + level * noise, dtype=np.float32)


def low_pass(audio: FloatArray, hertz: float) -> FloatArray:
    """Remove high frequencies, as telephones and cheap microphones do."""
    return np.asarray(sosfilt(butter(4, hertz, fs=SAMPLE_RATE_HZ, output="sos"), audio), dtype=np.float32)


def saturate(audio: FloatArray, drive: float) -> FloatArray:
    """Clip softly; small signals keep their level."""
    return np.asarray(np.tanh(drive * audio) / drive, dtype=np.float32)


def treat(audio: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Apply a random chain of equaliser, room, saturation and low-pass."""
    if rng.random() < 0.7:
        audio = equalise(audio, rng)
    if rng.random() < 0.45:
        audio = place_in_room(audio, rng)
    if rng.random() < 0.2:
        audio = saturate(audio, float(rng.uniform(0.5, 2.5)))
    if rng.random() < 0.2:
        audio = low_pass(audio, float(rng.uniform(4000, 11_000)))
    return audio
