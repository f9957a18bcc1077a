import numpy as np
import pytest

from echoavatar.errors import DependencyError
from echoavatar_lab.corpora.speech import speech
from echoavatar_lab.corpora.speech.script import write_monologue
from echoavatar_lab.corpora.speech.speech import draw_speaker, resolve_engine, silence, speak


def spoken(seed: int = 0, engine: str = "own"):
    rng = np.random.default_rng(seed)
    return speak(write_monologue(rng, 3), draw_speaker(rng, engine), rng, engine)


def test_pauses_are_digital_silence_and_phrases_are_not():
    track = spoken()
    phrases = track.phrases
    assert len(phrases) >= 3
    for (_, end), (start, _) in zip(phrases, phrases[1:], strict=False):
        gap = track.audio[round((end + 0.06) * 24000) : round((start - 0.06) * 24000)]
        if start - end > 0.3:
            assert np.abs(gap).max() < 1e-6
    for start, end in phrases:
        assert np.sqrt(np.mean(track.audio[round(start * 24000) : round(end * 24000)] ** 2)) > 0.01


def test_syllables_are_in_order_and_inside_phrases():
    track = spoken(1)
    vowels = [s.vowel for s in track.syllables]
    assert vowels == sorted(vowels)
    for syllable in track.syllables:
        assert syllable.start <= syllable.vowel <= syllable.end
        assert any(a - 1e-6 <= syllable.vowel <= b + 1e-6 for a, b in track.phrases)


def test_spans_cover_the_track():
    track = spoken(2)
    assert track.spans[0].start == 0
    assert track.spans[-1].end == pytest.approx(track.seconds)
    assert all(a.end == pytest.approx(b.start) for a, b in zip(track.spans, track.spans[1:], strict=False))


def test_long_pauses_count_as_silence():
    assert silence(0.3).spans[0].kind == "speech"
    assert silence(1.5).spans[0].kind == "silence"


def test_without_flite_auto_falls_back_and_insisting_fails(monkeypatch):
    def missing():
        raise DependencyError("flite is missing")

    monkeypatch.setattr(speech, "flite", missing)
    assert resolve_engine("auto") == "own"
    with pytest.raises(DependencyError):
        resolve_engine("flite")
