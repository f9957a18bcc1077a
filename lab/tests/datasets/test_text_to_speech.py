from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.speech_server import SpeechServer, speech_server

from echoavatar.errors import AudioError, DependencyError, EchoAvatarError
from echoavatar_lab.corpora.rehearsal.augment import loudness
from echoavatar_lab.datasets.conversations import Script, Turn, conversations
from echoavatar_lab.datasets.text_to_speech import HttpTextToSpeech, TextToSpeech, _pieces, text_to_speech

KEY = "sk-very-secret"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[SpeechServer]:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.setenv("ELEVENLABS_API_KEY", KEY)
    with speech_server() as found:
        yield found


def script() -> Script:
    first = next(conversations(0))
    return replace(first, turns=first.turns[:2])


def hurried(one: TextToSpeech) -> TextToSpeech:
    assert isinstance(one, HttpTextToSpeech)
    one.pause_s = 0.001
    return one


def test_our_own_engine_knows_its_stresses() -> None:
    one = text_to_speech("own")
    said, again = (one.read(script(), np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(said.audio, again.audio)
    assert len(said.audio) == 800 * len(said.domain)
    assert set(said.domain.tolist()) <= {0, 1}
    assert len(said.events["stress"]) > 3
    assert abs(loudness(said.audio) + 25) < 1
    with pytest.raises(AudioError, match="turn 1 has no word that a local engine can speak"):
        one.read(replace(script(), turns=(Turn(0, "你好", ()),)), np.random.default_rng(0))


def test_openai_is_asked_turn_by_turn_with_a_voice_a_speaker(server: SpeechServer) -> None:
    one = text_to_speech("openai", url=server.url, model="m", voices=("x", "y"))
    said = one.read(script(), np.random.default_rng(0))
    assert [path for _, path, _ in server.asked] == ["/v1/audio/speech"] * 2
    contents = server.contents
    assert [content["input"] for content in contents] == [turn.text for turn in script().turns]
    assert {content["voice"] for content in contents} == {"x", "y"} == set(said.voices)
    assert all(headers["authorization"] == f"Bearer {KEY}" for _, _, headers in server.asked)
    assert said.domain.any()
    length = sum(0.05 * len(turn.text) for turn in script().turns)
    assert length + 0.2 < len(said.audio) / 24_000 < length + 1.0  # and a gap
    assert KEY not in one.title + one.licence


def test_elevenlabs_is_asked_by_voice(server: SpeechServer) -> None:
    one = text_to_speech("elevenlabs", url=server.url, voices=("a/b",))
    one.read(script(), np.random.default_rng(0))
    _, path, headers = server.asked[0]
    assert path == "/v1/text-to-speech/a%2Fb?output_format=mp3_44100_128"
    assert headers["xi-api-key"] == KEY
    assert server.contents[0] == {"text": script().turns[0].text, "model_id": "eleven_multilingual_v2"}


def test_a_busy_service_is_asked_again(server: SpeechServer) -> None:
    server.answers = [429, 503]
    hurried(text_to_speech("openai", url=server.url)).read(script(), np.random.default_rng(0))
    assert len(server.asked) == 4
    server.answers = [500] * 4
    with pytest.raises(DependencyError, match="answers 500; run again later"):
        hurried(text_to_speech("openai", url=server.url)).read(script(), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("status", "kind", "words"),
    [(401, DependencyError, "answers 401: no ... here; check the key"), (400, AudioError, "refuses the text"),
     (302, DependencyError, "answers 302")],
)  # fmt: skip
def test_refusals_hide_the_key_and_redirects_are_not_followed(
    server: SpeechServer, status: int, kind: type[Exception], words: str
) -> None:
    server.answers, server.says = [status], f"no {KEY} here"
    with pytest.raises(kind, match=words) as told:
        text_to_speech("openai", url=server.url).read(script(), np.random.default_rng(0))
    assert KEY not in str(told.value)
    assert len(server.asked) == 1


def test_an_answer_without_sound_is_named(server: SpeechServer) -> None:
    server.is_sound = False
    with pytest.raises(AudioError, match="sent an answer that is not sound"):
        text_to_speech("openai", url=server.url).read(script(), np.random.default_rng(0))


def test_an_unreachable_service_is_named(server: SpeechServer, monkeypatch: pytest.MonkeyPatch) -> None:
    one = hurried(text_to_speech("openai", url="http://127.0.0.1:9/v1"))
    with pytest.raises(DependencyError, match=r"127\.0\.0\.1.* cannot be reached"):
        one.read(script(), np.random.default_rng(0))


def test_missing_keys_voices_and_addresses_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OPENAI_API_KEY", "ELEVENLABS_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(EchoAvatarError, match="OPENAI_API_KEY is not set"):
        text_to_speech("openai")
    assert text_to_speech("openai", url="http://localhost:1/v1").title == "localhost, gpt-4o-mini-tts"
    with pytest.raises(EchoAvatarError, match="ELEVENLABS_API_KEY is not set"):
        text_to_speech("elevenlabs", voices=("x",))
    with pytest.raises(EchoAvatarError, match="needs --voice"):
        text_to_speech("elevenlabs")
    with pytest.raises(EchoAvatarError, match="is not a web address"):
        text_to_speech("openai", url="file:///etc/passwd")
    with pytest.raises(EchoAvatarError, match="--tts own has its own voices"):
        text_to_speech("own", voices=("x",))


def test_long_turns_are_asked_in_pieces_and_nothing_is_lost() -> None:
    text = " ".join(f"Sentence {k} of many." for k in range(300))
    pieces = _pieces(Turn(0, text, ()))
    assert all(len(piece) <= 2000 for piece in pieces)
    assert " ".join(pieces) == text
    assert len(_pieces(Turn(0, "x" * 4100, ()))) == 3


def test_the_file_of_an_answer_is_not_left_behind(
    server: SpeechServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    text_to_speech("openai", url=server.url).read(script(), np.random.default_rng(0))
    assert not list(tmp_path.iterdir())
