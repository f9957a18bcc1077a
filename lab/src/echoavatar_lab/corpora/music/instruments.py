"""Sample-exact numpy instruments: the default, dependency-free renderer of a `Piece`.

Pitched voices mix two single-cycle wavetables (bright at the attack, dark later) under an envelope; drums are noise
and sine sweeps. Each rendering draws its own timbres.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray, Note, Piece

_TABLE = 2048
_RATE = SAMPLE_RATE_HZ
Array = np.ndarray


@dataclass(frozen=True)
class Timbre:
    """A pitched voice: spectral tilt (exponent of the harmonic number), envelope in seconds, colour."""

    tilt: float
    dark_tilt: float
    attack: float = 0.004
    decay: float = 0.0  # time constant of a struck or plucked note; 0 holds
    release: float = 0.06
    odd: float = 0.0  # 1: only odd harmonics
    vibrato: float = 0.0  # semitones
    voices: int = 1  # detuned unison
    formants: tuple[tuple[float, float], ...] = ()  # (Hz, gain)
    breath: float = 0.0
    gain: float = 1.0
    inharmonic: tuple[float, ...] = ()  # partial ratios of a bell


_AAH = ((700.0, 1.0), (1200.0, 0.5), (2600.0, 0.2))
_OOH = ((340.0, 1.0), (850.0, 0.25), (2400.0, 0.08))

TIMBRES: dict[str, Timbre] = {
    "piano": Timbre(1.3, 2.2, decay=0.7, release=0.12),
    "epiano": Timbre(2.2, 3.0, decay=0.9, release=0.1),
    "organ": Timbre(1.1, 1.1, attack=0.008, release=0.03, gain=0.7),
    "guitar": Timbre(1.0, 2.0, decay=0.35, release=0.08),
    "guitar_lead": Timbre(0.8, 1.2, attack=0.003, decay=1.5, vibrato=0.15),
    "fuzz": Timbre(0.5, 0.7, decay=1.2, voices=2, gain=0.6),
    "harp": Timbre(1.6, 2.8, decay=0.5, release=0.2),
    "strings": Timbre(1.1, 1.2, attack=0.04, release=0.18, voices=3, vibrato=0.1),
    "pad": Timbre(1.5, 1.8, attack=0.06, release=0.3, voices=3),
    "brass": Timbre(0.9, 1.0, attack=0.025, release=0.08, voices=2),
    "accordion": Timbre(0.9, 0.9, attack=0.02, release=0.05, voices=2, gain=0.7),
    "flute": Timbre(2.4, 2.6, attack=0.03, release=0.08, vibrato=0.25, breath=0.08),
    "clarinet": Timbre(1.2, 1.4, attack=0.02, release=0.06, odd=0.9),
    "trumpet": Timbre(0.7, 0.8, attack=0.02, release=0.06, vibrato=0.15),
    "violin": Timbre(0.9, 1.0, attack=0.035, release=0.1, vibrato=0.3),
    "cello": Timbre(1.0, 1.1, attack=0.035, release=0.12, vibrato=0.2),
    "voice_aah": Timbre(1.0, 1.0, attack=0.04, release=0.12, vibrato=0.4, formants=_AAH, breath=0.02, gain=1.4),
    "voice_ooh": Timbre(1.0, 1.0, attack=0.05, release=0.12, vibrato=0.35, formants=_OOH, breath=0.02, gain=1.4),
    "saw_lead": Timbre(0.9, 1.1, attack=0.005, voices=2),
    "square_lead": Timbre(0.9, 1.0, attack=0.005, odd=1.0),
    "bell": Timbre(1.0, 1.0, decay=0.8, inharmonic=(1.0, 2.76, 5.4, 8.9), release=0.3),
    "finger_bass": Timbre(1.4, 2.4, decay=0.6, gain=1.5),
    "synth_bass": Timbre(0.9, 1.6, decay=0.4, gain=1.3),
    "sub_bass": Timbre(3.0, 3.5, attack=0.008, gain=1.8),
    "tuba": Timbre(1.5, 1.6, attack=0.025, gain=1.4),
}


def render(piece: Piece, rng: np.random.Generator) -> FloatArray:
    """Play a piece: audio (s,), 24 kHz, peak near 0.9, cut or faded out at the piece's end."""
    length = round(piece.seconds * _RATE)
    mix = np.zeros(length + 4 * _RATE)
    colours = {name: float(rng.uniform(-0.25, 0.35)) for name in sorted({note.instrument for note in piece.notes})}
    gains = {name: float(10 ** (rng.uniform(-4, 3) / 20)) for name in colours}
    cache: dict[tuple[str, int, int], Array] = {}
    for note in piece.notes:
        key = (note.instrument, note.pitch, round(note.duration * 50))
        if key not in cache:
            colour, timbre = colours[note.instrument], TIMBRES.get(note.instrument)
            cache[key] = _drum(note.instrument, colour, rng) if timbre is None else _tone(timbre, note, colour, rng)
        wave = cache[key]
        start = round(note.start * _RATE)
        stop = min(len(mix), start + len(wave))
        mix[start:stop] += gains[note.instrument] * note.velocity**1.5 * wave[: stop - start]
    return mastered(mix[:length], piece)


def mastered(mix: FloatArray, piece: Piece) -> FloatArray:
    """A mix (s,) as long as its piece, cut or faded out at the end, softly limited to a peak near 0.9."""
    fade = round((0.005 if piece.is_cut else 0.8) * _RATE)
    mix[-fade:] *= np.linspace(1, 0, fade)
    drive = 1.2 / max(float(np.quantile(np.abs(mix), 0.999)), 1e-6)
    return np.asarray(0.9 * np.tanh(drive * mix), np.float32)


def _tone(timbre: Timbre, note: Note, colour: float, rng: np.random.Generator) -> Array:
    hertz = 440 * 2 ** ((note.pitch - 69) / 12)
    time = np.arange(round((note.duration + 4 * timbre.release) * _RATE)) / _RATE
    bright = _cycle(timbre, hertz, timbre.tilt + colour)
    dark = _cycle(timbre, hertz, timbre.dark_tilt + colour)
    blend = np.exp(-time / (0.6 * timbre.decay)) if timbre.decay else np.full(len(time), 0.5)
    wave = np.zeros(len(time))
    for voice in range(timbre.voices):
        cents = (voice - (timbre.voices - 1) / 2) * 9
        wave += _play(timbre, bright, dark, blend, hertz * 2 ** (cents / 1200), time, rng)
    if timbre.breath:
        wave += timbre.breath * lfilter([1], [1, -0.6], rng.standard_normal(len(time)))
    envelope = np.minimum(1, time / timbre.attack)
    if timbre.decay:
        envelope *= np.exp(-time / timbre.decay)
    over = np.maximum(0, time - note.duration)
    return np.asarray(timbre.gain / timbre.voices**0.5 * wave * envelope * np.exp(-over / timbre.release))


def _play(
    timbre: Timbre, bright: Array, dark: Array, blend: Array, hertz: float, time: Array, rng: np.random.Generator
) -> Array:
    """One voice; both tables are read at the same phase."""
    phase = hertz * time
    if timbre.vibrato:
        depth = hertz * (2 ** (timbre.vibrato / 12) - 1)
        rate = rng.uniform(4.8, 6.2)
        phase = phase + depth / (2 * np.pi * rate) * np.minimum(1, time / 0.4) * -np.cos(2 * np.pi * rate * time)
    if timbre.inharmonic:
        parts = [np.sin(2 * np.pi * r * phase) * 0.6**i for i, r in enumerate(timbre.inharmonic) if r * hertz < 11000]
        return np.asarray(np.sum(parts, axis=0))
    place = ((phase + rng.random()) * _TABLE).astype(np.int64) & (_TABLE - 1)
    return np.asarray(dark[place] + blend * (bright[place] - dark[place]))


def _cycle(timbre: Timbre, hertz: float, tilt: float) -> Array:
    """One period (table,) of unit RMS, harmonics below 11 kHz."""
    count = max(1, min(60, int(11_000 / hertz)))
    order = np.arange(1, count + 1)
    level = order.astype(np.float64) ** -max(tilt, 0.4)
    level *= np.where(order % 2 == 0, 1 - timbre.odd, 1.0)
    if timbre.formants:
        shape = sum(g * np.exp(-0.5 * ((order * hertz - f) / (90 + 0.06 * f)) ** 2) for f, g in timbre.formants)
        level = level * (shape + 0.02)
    spectrum = np.zeros(_TABLE // 2 + 1, np.complex128)
    spectrum[order] = level * np.exp(1j * (order * order * 0.7))
    cycle = np.fft.irfft(spectrum)
    return np.asarray(cycle / np.sqrt(np.mean(cycle**2)) * 0.35)


def _drum(name: str, colour: float, rng: np.random.Generator) -> Array:
    time = np.arange(round(0.9 * _RATE)) / _RATE
    noise = rng.standard_normal(len(time))
    high = lfilter([1, -0.95], [1], noise)
    scale = 1 + colour
    if name == "kick":
        phase = 2 * np.pi * (48 * scale * time + 3.2 * (1 - np.exp(-time / 0.03)))
        return np.asarray(1.6 * np.sin(phase) * np.exp(-time / 0.13) + 0.25 * high * np.exp(-time / 0.004))
    if name in ("tom_high", "tom_low", "conga"):
        base = {"tom_high": 170, "tom_low": 100, "conga": 240}[name] * scale
        phase = 2 * np.pi * base * (time + 0.02 * (1 - np.exp(-time / 0.04)))
        return np.asarray(1.1 * np.sin(phase) * np.exp(-time / 0.12) + 0.1 * noise * np.exp(-time / 0.01))
    if name in ("snare", "clap", "brush"):
        body = 0.5 * np.sin(2 * np.pi * 190 * scale * time) * np.exp(-time / 0.06) * (name == "snare")
        length = {"snare": 0.09, "clap": 0.07, "brush": 0.05}[name] * scale
        return np.asarray(body + 0.5 * lfilter([1, -0.6], [1], noise) * np.exp(-time / length))
    if name in ("clave", "bell_bar"):
        base = {"clave": 2400.0, "bell_bar": 560.0}[name] * scale
        tone = np.sin(2 * np.pi * base * time) + 0.6 * np.sin(2 * np.pi * 1.48 * base * time)
        return np.asarray(0.5 * tone * np.exp(-time / (0.03 if name == "clave" else 0.12)))
    if name == "ride":
        ping = np.sin(2 * np.pi * 3100 * scale * time) + np.sin(2 * np.pi * 4370 * scale * time)
        return np.asarray((0.15 * ping + 0.2 * high) * np.exp(-time / 0.18))
    length = {"hat": 0.025, "open_hat": 0.12, "shaker": 0.03, "crash": 0.45}[name]
    return np.asarray(0.45 * high * np.exp(-time / length) * np.minimum(1, time / 0.002))
