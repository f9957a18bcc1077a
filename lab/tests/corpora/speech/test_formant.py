import numpy as np
import pytest

from echoavatar_lab.corpora.speech.formant import FORMANT_VOICES, say
from echoavatar_lab.corpora.speech.prosody import Delivery
from echoavatar_lab.corpora.speech.script import Word

WORDS = (Word("we"), Word("found"), Word("the"), Word("golden"), Word("river", is_focus=True, mark="."))


@pytest.mark.parametrize("voice", FORMANT_VOICES)
def test_vowels_are_loud_where_the_labels_say(voice):
    said = say(WORDS, Delivery(voice=voice), 1)
    power = np.convolve(said.audio**2, np.ones(480) / 480, mode="same")
    middle = np.median(power)
    for syllable in said.syllables:
        assert power[round(syllable.vowel * 24000)] > 0.8 * middle
    assert power[: round(0.015 * 24000)].max() < 0.1 * middle


def test_faster_speech_is_shorter():
    slow, fast = (say(WORDS, Delivery(voice="bass", rate=rate), 1) for rate in (0.8, 1.3))
    assert len(fast.audio) < 0.7 * len(slow.audio)


def test_a_comma_is_a_pause_in_the_times():
    said = say((Word("well", mark=","), Word("right")), Delivery(voice="tenor"), 0)
    assert said.syllables[1].start - said.syllables[0].end >= 0.1


def test_the_focus_is_the_most_prominent():
    said = say(WORDS, Delivery(voice="tenor"), 0)
    assert max(said.syllables, key=lambda s: s.prominence).word == 4
