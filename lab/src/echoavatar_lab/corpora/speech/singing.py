"""Singing over any music with known beats: formant voices sing words on notes that fit the music's harmony.

Recorded singing with free terms is rare, and a model that never heard any takes a song for speech. Not in the paper.
"""

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import FloatArray, Source, TimeArray
from .formant import FORMANT_VOICES, VOICE, Array, synthesise
from .pronounce import VOWELS, syllabify
from .script import write_sentence

_FFT = 8192
_CONSONANT_S = 0.07
_HOP_S = 0.005  # of the formant synthesiser


def sing(music: FloatArray, beats: TimeArray, rng: np.random.Generator) -> tuple[FloatArray, Source]:
    """A voice (s,) to lay over the music (s,), silent before the first note, and the stretch in which it sings.

    Phrases of 3 to 7 notes of one or two beats; notes follow the strongest pitch classes of the music.
    """
    voice = FORMANT_VOICES[rng.integers(len(FORMANT_VOICES))]
    hertz, scale = VOICE[voice]
    frames = int(np.ceil(len(music) / SAMPLE_RATE_HZ / _HOP_S)) + 1
    phones: list[tuple[float, float, str]] = []
    pitch = np.full(frames, hertz)
    lowest = round(12 * np.log2(hertz / 440) + 69)
    at, wanted = int(rng.integers(0, 4)), lowest + float(rng.uniform(2, 9))
    words = _syllables(rng)
    while at + 1 < len(beats):
        notes = int(rng.integers(3, 8))
        for _ in range(notes):
            length = int(rng.choice([1, 1, 2]))
            if at + length >= len(beats):
                break
            start, end = float(beats[at]), float(beats[at + length])
            note = _fitting(music, start, wanted)
            wanted = float(np.clip(note + rng.choice([-4, -2, 0, 2, 4]), lowest, lowest + 16))
            words = words or _syllables(rng)
            phones += _placed(words.pop(0), start, end)
            a, b = int(start / _HOP_S), min(frames, int(end / _HOP_S))
            pitch[a:b] = 440 * 2 ** ((note - 69) / 12)
            at += length
        at += int(rng.integers(1, 5))
    smooth = np.hanning(15)[1:-1] / np.hanning(15)[1:-1].sum()
    pitch = np.convolve(np.pad(pitch, 6, mode="edge"), smooth, mode="valid")  # glides of 60 ms
    time = np.arange(frames) * _HOP_S
    pitch = pitch * 2 ** (rng.uniform(0.2, 0.5) / 12 * np.sin(2 * np.pi * rng.uniform(5, 6.2) * time))
    sung = synthesise(phones, pitch, scale * float(rng.uniform(0.94, 1.06)), rng)[: len(music)]
    sung = np.pad(sung, (0, len(music) - len(sung)))
    first, last = (phones[0][0], phones[-1][1]) if phones else (0.0, 0.0)
    level = 0.5 / max(float(np.abs(sung).max()), 1e-9)
    return (level * sung).astype(np.float32), Source(first, last, "singing", f"formant {voice}", "synthetic")


def _syllables(rng: np.random.Generator) -> list[tuple[str, ...]]:
    """Phones of the syllables of a sentence."""
    return [tuple(names) for word in write_sentence(rng).words for names, _ in syllabify(word.text)]


def _placed(names: tuple[str, ...], start: float, end: float) -> list[tuple[float, float, str]]:
    """Phones of one note: the vowel begins on the beat, so consonants before it come early."""
    vowel = next((i for i, name in enumerate(names) if name in VOWELS), 0)
    after = names[vowel + 1 :]
    held = end - _CONSONANT_S * (len(after) + 1.2)
    if held - start < 0.12:
        after, held = (), end - _CONSONANT_S
    times = [(start - _CONSONANT_S * (vowel - i), start - _CONSONANT_S * (vowel - i - 1)) for i in range(vowel)]
    times.append((start, held))
    times += [(held + _CONSONANT_S * i, held + _CONSONANT_S * (i + 1)) for i in range(len(after))]
    kept = (*names[: vowel + 1], *after)
    return [(max(a, 0.0), max(b, 0.0), name) for (a, b), name in zip(times, kept, strict=True)]


def _fitting(music: FloatArray, start: float, wanted: float) -> int:
    """The MIDI note near `wanted` whose pitch class is strong in the music after `start`."""
    first = round(start * SAMPLE_RATE_HZ)
    part = music[first : first + _FFT]
    spectrum = np.abs(np.fft.rfft(part * np.hanning(len(part)), _FFT))
    bins = np.arange(19, 700)  # 56 Hz to 2 kHz
    classes = np.round(12 * np.log2(bins * SAMPLE_RATE_HZ / _FFT / 440) + 69).astype(int) % 12
    chroma: Array = np.bincount(classes, np.sqrt(spectrum[bins]), 12) / np.bincount(classes, minlength=12)
    near = np.arange(round(wanted) - 5, round(wanted) + 6)
    score = chroma[near % 12] / max(float(chroma.max()), 1e-9) - 0.06 * np.abs(near - wanted)
    return int(near[np.argmax(score)])
