import numpy as np

from echoavatar_lab.corpora.gesture.head_motion import head_accents, speech_activity
from echoavatar_lab.corpora.sound import SoundTrack


def test_activity_follows_the_phrases(talk: SoundTrack):
    active = speech_activity(talk, 456)
    assert active[45] < 1e-3
    assert active[round(3.5 * 30)] > 0.95
    assert active[round(6.5 * 30)] < 0.02


def test_the_head_nods_on_stress(talk: SoundTrack):
    """Averaged over many speakers, the head is lowest shortly after the vowel of the strongest syllable."""
    pitch = np.mean([head_accents(talk, 1.0, np.random.default_rng(s))[0][:, 1] for s in range(60)], axis=0)
    vowel = talk.syllables[7].vowel  # "sang"
    window = pitch[round((vowel - 0.3) * 30) : round((vowel + 0.6) * 30)]
    assert 0.0 <= window.argmax() / 30 - 0.3 <= 0.3
    assert window.max() > 0.05


def test_silence_gets_no_accents(talk: SoundTrack):
    head, spine = head_accents(talk, 1.0, np.random.default_rng(2))
    assert np.abs(head[-60:]).max() < 0.005
    assert np.abs(spine[-60:]).max() < 0.005
