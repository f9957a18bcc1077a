"""Prominence of syllables, and the pitch and loudness that make it audible, for any speech engine.

Prominence drives the synthetic gestures, so it must be audible: the pitch range is widened, and prominent vowels are
higher and louder. Not in the paper.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..sound import STRESSED, FloatArray
from .script import Word

_WEAK_TEXT = """
    i you we they he she it me them us my your his her our their mine yours do did does is are was were am be the a an
    and or but if when while so to of in on at by near for than that this there with not no too very can could would
    will until because
"""
_WEAK_WORDS = frozenset(_WEAK_TEXT.split())  # pronouns, auxiliaries and other function words
_BUMP_SD_S = 0.07


@dataclass(frozen=True)
class Delivery:
    """How one speaker speaks: voice name, rate (above 1 is faster), pitch factor, formants, pitch expression."""

    voice: str = "slt"
    rate: float = 1.0
    pitch: float = 1.0
    alpha: float = 0.42  # frequency warping of the vocoder: formants up or down
    spread: float = 1.7  # factor of the pitch range
    bump_semitones: float = 4.0
    nucleus_db: float = 3.0


@dataclass(frozen=True)
class SpokenSyllable:
    """A syllable from an engine; `word` is an index into the script's words; times in seconds."""

    start: float
    end: float
    vowel: float
    word: int
    is_stressed: bool
    has_accent: bool = False
    prominence: float = 0.0


@dataclass(frozen=True)
class Utterance:
    """Speech of one breath group: audio (s,) at 24 kHz without outer silence, phones (start, end, name)."""

    audio: FloatArray
    phones: tuple[tuple[float, float, str], ...]
    syllables: tuple[SpokenSyllable, ...]


def draw_delivery(rng: np.random.Generator, voices: tuple[str, ...]) -> Delivery:
    """Draw a random speaker."""
    return Delivery(
        voice=voices[rng.integers(len(voices))],
        rate=float(rng.uniform(0.8, 1.3)),
        pitch=float(rng.uniform(0.8, 1.25)),
        alpha=float(rng.uniform(0.37, 0.47)),
        spread=float(rng.uniform(1.2, 2.2)),
        bump_semitones=float(rng.uniform(2.5, 6)),
        nucleus_db=float(rng.uniform(1, 4)),
    )


def score_prominence(syllables: tuple[SpokenSyllable, ...], words: tuple[Word, ...]) -> tuple[SpokenSyllable, ...]:
    """Set prominences: 1.0 for focus, 0.85 for the last stressed content word of a phrase, less for other stresses."""
    scored = [replace(s, prominence=_base_score(s, words[s.word])) for s in syllables]
    for first, last in _breath_groups(scored):
        group = range(first, last)
        if any(scored[i].prominence >= 1 for i in group):
            continue
        content = [i for i in group if scored[i].prominence >= STRESSED]
        fallback = [i for i in group if scored[i].is_stressed]
        for i in (content or fallback or list(group))[-1:]:
            scored[i] = replace(scored[i], prominence=0.85)
    return tuple(scored)


def _base_score(syllable: SpokenSyllable, word: Word) -> float:
    if not syllable.is_stressed:
        return 0.0
    if word.is_focus:
        return 1.0
    if word.text.lower() in _WEAK_WORDS:
        return 0.45 if word.meaning else 0.1
    return 0.45 + 0.2 * syllable.has_accent + 0.1 * bool(word.meaning)


def _breath_groups(syllables: list[SpokenSyllable]) -> list[tuple[int, int]]:
    """Index ranges between gaps of more than 60 ms."""
    cuts = [i for i in range(1, len(syllables)) if syllables[i].start - syllables[i - 1].end > 0.06]
    edges = [0, *cuts, len(syllables)]
    return [(a, b) for a, b in zip(edges, edges[1:], strict=False) if b > a]


def shape_pitch(
    f0: npt.NDArray[np.float32],
    *,
    frame_s: float,
    syllables: tuple[SpokenSyllable, ...],
    delivery: Delivery,
    is_question: bool,
) -> npt.NDArray[np.float32]:
    """Expressive pitch from plain pitch (t,) in Hz, 0 where unvoiced."""
    voiced = f0 > 0
    if not voiced.any():
        return f0
    centre = float(np.median(f0[voiced]))
    semitones = 12 * np.log2(np.where(voiced, f0, centre) / centre) * delivery.spread
    time = np.arange(len(f0)) * frame_s
    for syllable in syllables:
        if syllable.prominence >= STRESSED:
            bump = np.exp(-0.5 * ((time - syllable.vowel) / _BUMP_SD_S) ** 2)
            semitones = semitones + delivery.bump_semitones * syllable.prominence * bump
    if is_question and syllables:
        last = syllables[-1]
        ramp = np.clip((time - last.start) / max(last.end - last.start, 0.05), 0, 1)
        semitones = semitones + 6 * ramp
    shaped = centre * delivery.pitch * 2 ** (np.clip(semitones, -14, 16) / 12)
    return np.where(voiced, np.clip(shaped, 50, 480), 0).astype(np.float32)


def lift_nuclei(audio: FloatArray, rate_hz: int, syllables: tuple[SpokenSyllable, ...], db: float) -> FloatArray:
    """Raise the loudness smoothly around prominent vowels, by up to `db`."""
    time = np.arange(len(audio)) / rate_hz
    gain = np.zeros(len(audio))
    for syllable in syllables:
        if syllable.prominence >= STRESSED:
            a, b = np.searchsorted(time, [syllable.vowel - 0.25, syllable.vowel + 0.25])
            near = time[a:b] - syllable.vowel
            gain[a:b] += syllable.prominence * db * np.exp(-0.5 * (near / 0.08) ** 2)
    return (audio * 10 ** (gain / 20)).astype(np.float32)
