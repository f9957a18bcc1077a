import numpy as np

from echoavatar.models.generator.manner import draw_manner
from echoavatar_lab.corpora.gesture.gesture_cues import gesture_cues
from echoavatar_lab.corpora.gesture.speakers import pace_of
from echoavatar_lab.corpora.sound import SoundTrack


def test_strokes_end_just_after_the_vowels_of_prominent_syllables(talk: SoundTrack):
    for seed in range(20):
        for phrase in talk.phrases:
            cues = gesture_cues(talk, phrase, pace_of(draw_manner(seed)), np.random.default_rng(seed))
            for cue in cues:
                syllable = max((s for s in talk.syllables if s.vowel < cue.stroke_end), key=lambda s: s.vowel)
                assert cue.vowel == syllable.vowel
                assert 0.14 <= cue.stroke_end - cue.vowel <= 0.18
                assert syllable.prominence >= 0.35
                assert cue.onset <= syllable.start
            ends = np.array([cue.stroke_end for cue in cues])
            assert np.all(np.diff(ends) > 0.3)


def test_about_half_of_the_meanings_get_a_gesture(talk: SoundTrack):
    found = [
        cue.meaning
        for seed in range(20)
        for phrase in talk.phrases
        for cue in gesture_cues(talk, phrase, pace_of(draw_manner(seed)), np.random.default_rng(seed))
    ]
    for meaning in ("greeting", "size", "negation"):
        assert 10 <= found.count(meaning) <= 20
