import numpy as np
import pytest

from echoavatar.errors import DependencyError
from echoavatar_lab.corpora.speech import flite as module
from echoavatar_lab.corpora.speech.flite import VOICES, Flite, flite
from echoavatar_lab.corpora.speech.prosody import Delivery
from echoavatar_lab.corpora.speech.script import Word

WORDS = (Word("we"), Word("found"), Word("the"), Word("golden"), Word("river", is_focus=True, mark="."))


@pytest.fixture(scope="module")
def engine():
    try:
        return flite()
    except DependencyError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("voice", VOICES)
def test_labels_lie_on_the_sound(engine, voice):
    said = engine.say(WORDS, Delivery(voice=voice), 1)
    assert abs(len(said.audio) / 24000 - said.phones[-1][1] - 0.03) < 0.02
    assert [s.word for s in said.syllables] == [0, 1, 2, 3, 3, 4, 4]
    power = np.convolve(said.audio**2, np.ones(480) / 480, mode="same")
    stressed = [power[round(s.vowel * 24000)] for s in said.syllables if s.is_stressed and s.prominence > 0.4]
    assert min(stressed) > np.median(power)


def test_the_same_seed_gives_the_same_samples(engine):
    first = engine.say(WORDS, Delivery(voice="slt"), 5).audio
    engine.say(WORDS, Delivery(voice="awb", rate=1.3, alpha=0.45), 6)
    assert np.array_equal(first, engine.say(WORDS, Delivery(voice="slt"), 5).audio)


def test_rate_and_formants_change_the_sound(engine):
    plain, fast, warped = (
        engine.say(WORDS, Delivery(voice="slt", rate=rate, alpha=alpha), 5).audio
        for rate, alpha in ((1.0, 0.42), (1.3, 0.42), (1.0, 0.46))
    )
    assert len(fast) < 0.85 * len(plain)
    assert len(warped) == len(plain)
    assert not np.allclose(warped, plain, atol=0.05)


def test_a_missing_library_says_what_to_install(monkeypatch):
    monkeypatch.setattr(module.ctypes.util, "find_library", lambda name: None)
    with pytest.raises(DependencyError, match="apt install flite"):
        Flite()
