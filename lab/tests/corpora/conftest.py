"""Short silent sound tracks with known labels, for the tests of the choreography."""

import numpy as np
import pytest

from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.corpora.sound import SoundTrack, Span, Syllable


def _sentence(begin: float, words: list[tuple[str, float, str]]) -> list[Syllable]:
    """One syllable per word, 0.28 s each, the vowel in its middle."""
    return [
        Syllable(begin + 0.28 * i, begin + 0.28 * (i + 1), begin + 0.28 * i + 0.14, prominence, word, meaning)
        for i, (word, prominence, meaning) in enumerate(words)
    ]


@pytest.fixture(scope="session")
def talk() -> SoundTrack:
    """2 s silence, a phrase, 3 s silence, a phrase, 4 s silence: 15.2 s."""
    plain = [("this", 0.1, ""), ("story", 0.9, ""), ("was", 0.0, ""), ("old", 0.6, ""), ("and", 0.1, "")]
    first = _sentence(2.0, [("hello", 0.9, "greeting"), *plain, ("we", 0.2, ""), ("sang", 1.0, "")])
    second = _sentence(
        7.24, [("it", 0.1, ""), ("was", 0.0, ""), ("huge", 1.0, "size"), *plain, ("no", 1.0, "negation")]
    )
    phrases = ((first[0].start, first[-1].end), (second[0].start, second[-1].end))
    spans = (
        Span(0.0, phrases[0][0], "silence"),
        Span(*phrases[0], "speech"),
        Span(phrases[0][1], phrases[1][0], "silence"),
        Span(*phrases[1], "speech"),
        Span(phrases[1][1], 15.2, "silence"),
    )
    audio = np.zeros(round(15.2 * SAMPLE_RATE_HZ), np.float32)
    return SoundTrack(audio, spans=spans, syllables=tuple(first + second), phrases=phrases)


@pytest.fixture(scope="session")
def talk_then_music() -> SoundTrack:
    """A phrase, then 8 s of music at 120 bpm, then 4 s of silence: 15.2 s."""
    words = _sentence(0.5, [("so", 0.2, ""), ("listen", 1.0, ""), ("to", 0.0, ""), ("that", 0.9, "")])
    phrases = ((words[0].start, words[-1].end),)
    spans = (Span(0.0, 3.2, "speech"), Span(3.2, 11.2, "music"), Span(11.2, 15.2, "silence"))
    beats = 3.2 + np.arange(16) * 0.5
    return SoundTrack(
        np.zeros(round(15.2 * SAMPLE_RATE_HZ), np.float32),
        spans=spans,
        syllables=tuple(words),
        phrases=phrases,
        beats=beats,
        downbeats=beats[::4],
        style="pop",
        bpm=120.0,
    )
