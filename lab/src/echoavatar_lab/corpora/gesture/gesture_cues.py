"""Which syllables of a phrase get a gesture: prominent or meaningful ones, at a least distance in time."""

from dataclasses import dataclass

import numpy as np

from ..sound import SoundTrack, Syllable

LEAST_SALIENCE = 0.36
LAG_S = (0.14, 0.18)  # from a vowel's centre to the end of its stroke, drawn at random


@dataclass(frozen=True)
class Cue:
    """A syllable that gets a gesture; times in seconds, `vowel` is the vowel's centre, `weight` 0..1."""

    onset: float
    vowel: float
    stroke_end: float
    weight: float
    meaning: str
    word: str


def gesture_cues(track: SoundTrack, phrase: tuple[float, float], pace: float, rng: np.random.Generator) -> list[Cue]:
    """Cues of a phrase in order of time; where syllables are too close together the most salient one wins.

    `pace` is 1 for a person in conversation; above it, more syllables get a gesture.
    """
    begin, end = phrase
    inside = [s for s in track.syllables if begin - 0.02 <= s.vowel < end]
    spoken: set[tuple[float, str]] = set()
    cues: list[Cue] = []
    for i in sorted(range(len(inside)), key=lambda k: -_salience(inside[k])):
        syllable, onset = inside[i], _word_onset(inside, i)
        wanted = _salience(syllable) * (0.9 + 0.2 * rng.random()) * pace
        gap = 0.33 / pace if wanted < 0.8 else 0.38
        stroke_end = syllable.vowel + float(rng.uniform(*LAG_S))
        if (
            wanted < LEAST_SALIENCE
            or any(abs(cue.stroke_end - stroke_end) < gap for cue in cues)
            or rng.random() < 0.03
        ):
            continue
        meaning = syllable.meaning if rng.random() < 0.50 and (onset, syllable.word) not in spoken else ""
        spoken.add((onset, syllable.word))
        cues.append(Cue(onset, syllable.vowel, stroke_end, min(syllable.prominence, 1.0), meaning, syllable.word))
    return sorted(cues, key=lambda cue: cue.stroke_end)


def _salience(syllable: Syllable) -> float:
    return syllable.prominence + (0.35 if syllable.meaning and syllable.prominence > 0.3 else 0.0)


def _word_onset(syllables: list[Syllable], index: int) -> float:
    """Start of the word that a syllable belongs to."""
    while (
        index
        and syllables[index - 1].word == syllables[index].word
        and syllables[index].start - syllables[index - 1].end < 0.05
    ):
        index -= 1
    return syllables[index].start
