import base64
import io
import json
import os
import shutil
import tempfile
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from starlette.applications import Starlette
from starlette.testclient import TestClient
from tests.http_server import HttpServer, running

from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, voice
from echoavatar.server.clients import ClientLimits, ClientRates
from echoavatar.server.voice import MOST_GAIN, PEAK, Said, find_voice, language_of, speak, voice_route, voices, wav_of
from echoavatar.timing import SAMPLE_RATE_HZ

PROGRAMS = [name for name in ("flite", "espeak-ng") if shutil.which(name)]


@pytest.fixture
def only(monkeypatch):
    """A machine with these voices and no other."""

    def use(*kinds):
        monkeypatch.setattr(voice, "VOICES", [voice._Kind(*kind) for kind in kinds])
        voice._load.cache_clear()

    yield use
    voice._load.cache_clear()


def beep(text, language=""):
    """A tenth of a second a letter, after half a second of silence."""
    tone = 0.1 * np.sin(np.arange(2_400 * len(text)) / 9).astype(np.float32)
    words = ((text.split()[0], 0.5, 0.6),)
    return Said(np.concatenate([np.zeros(12_000, np.float32), tone]), words)


@pytest.mark.parametrize("name", PROGRAMS)
def test_text_becomes_sound(name, only):
    only((name, "", lambda: voice._program(name)))
    (said,), (longer,) = speak("Hello there."), speak("Hello there, and hello to all the others as well.")
    assert 0.3 * SAMPLE_RATE_HZ < len(said.samples) < len(longer.samples)
    assert 0.3 < abs(said.samples).max() <= PEAK + 1e-3


@pytest.mark.parametrize("name", PROGRAMS)
def test_text_is_never_taken_for_an_option(name, only):
    only((name, "", lambda: voice._program(name)))
    (said,) = speak("-w /etc/passwd --help")
    assert len(said.samples) > 0.5 * SAMPLE_RATE_HZ


def test_nothing_and_too_much_are_refused():
    for text in ("", "  ", "a" * 601):
        with pytest.raises(EchoAvatarError, match="letters"):
            speak(text)


def test_without_a_temporary_folder_it_is_one_line(monkeypatch, only):
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [os.devnull])
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setitem(voice._PROGRAMS, "false", ())
    only(("parrot", "", lambda: voice._program("false")))
    with pytest.raises(EchoAvatarError, match="parrot could not say that: .*temporary"):
        list(speak("hello"))


def test_a_voice_that_fails_is_named(monkeypatch, only):
    monkeypatch.setitem(voice._PROGRAMS, "false", ())
    only(("false", "", lambda: voice._program("false")))
    with pytest.raises(EchoAvatarError, match="false could not"):
        list(speak("hello"))


def test_what_does_not_load_is_not_offered(only, caplog):
    def absent():
        raise ModuleNotFoundError("hibari")

    def broken():
        raise OSError("no such instruction")

    only(("hibari", "en", absent), ("nano", "de", broken), ("parrot", "", lambda: beep))
    assert [one.name for one in voices()] == ["parrot"]
    assert find_voice() == "parrot"
    assert "nano does not load: no such instruction" in caplog.text
    only(("hibari", "en", absent))
    assert (voices(), find_voice()) == ([], "")
    with pytest.raises(EchoAvatarError, match="pip install"):
        speak("hello")


@pytest.mark.parametrize(
    ("text", "language"),
    [
        ("Hello, I am here and you are there.", "en"),
        ("wave", "en"),
        ("Guten Tag, ich bin die Maya und das ist nicht schwer.", "de"),
        ("Bonjour, je suis Maya et c'est très simple.", "fr"),
        ("Hola, yo soy Maya y esto es muy simple.", "es"),
        ("Ciao, questo non è molto difficile per me.", "it"),
        ("\u4f60\u597d", "cmn"),
        ("\u041f\u0440\u0438\u0432\u0435\u0442", "ru"),
        ("\u0e2a\u0e27\u0e31", ""),
        ("123", "en"),
    ],
)
def test_the_language_of_a_text(text, language):
    assert language_of(text) == language


def test_each_language_has_its_voice(only):
    said = []

    def kind(name, languages):
        return name, languages, lambda: lambda text, language: (said.append((name, language)), beep(text))[1]

    only(kind("english", "en"), kind("many", "de fr"))
    for text in ("Hello you.", "Das ist nicht gut.", "Ciao, questo non è per me."):
        list(speak(text))
    assert said == [("english", "en"), ("many", "de"), ("english", "en")]
    with pytest.raises(EchoAvatarError, match="no voice here speaks the language of"):
        speak("\u4f60\u597d")


def test_a_text_is_said_by_sentences_loud_enough_and_at_once(only):
    only(("parrot", "en", lambda: beep))
    first, second = speak("Dr. Who is <b>here</b>. Look!")
    assert abs(len(first.samples) - (1_200 + 2_400 * len("Dr. Who is  here ."))) < 200, "0.05 s of silence are left"
    assert len(second.samples) == 12_000 + 2_400 * len("Look!"), "a pause between sentences stays"
    assert abs(first.samples).max() == pytest.approx(0.1 * MOST_GAIN, rel=0.01)
    assert first.words[0][:2] == ("Dr.", pytest.approx(0.05, abs=0.01))
    assert second.words == (("Look!", 0.5, 0.6),)


def test_a_voice_without_sound_says_so(only):
    only(("parrot", "en", lambda: lambda *_: Said(np.zeros(0, np.float32))))
    with pytest.raises(EchoAvatarError, match="parrot has no sound for"):
        list(speak("hm"))


def test_words_get_the_times_of_their_phonemes():
    token = SimpleNamespace
    tokens = [
        token(text="Look", phonemes="l?k", whitespace=" "),
        token(text="me", phonemes="mi", whitespace=""),
        token(text="!", phonemes="!", whitespace=""),
    ]
    frames = [10, 2, 4, 1, 2, 3, 1, 7]  # a pad, l, k, the space, m, i, the mark, a pad
    found = voice._times(tokens, frames, dict.fromkeys("lk mi!"), 600 * sum(frames))
    expected = [("Look", 10, 16), ("me!", 17, 23)]
    for (text, begin, end), (word, first, last) in zip(found, expected, strict=True):
        assert (text, begin, end) == (word, pytest.approx(first / 40 - 0.06), pytest.approx(last / 40 - 0.06))
    assert voice._times(tokens, frames[:-1], dict.fromkeys("lk mi!"), 600) == (), "they do not fit: no words"


def test_a_field_of_protobuf():
    assert voice._message(1, b"ab") == b"\x0a\x02ab"
    assert voice._message(7, bytes(300))[:3] == b"\x3a\xac\x02"


def test_hibari_tells_its_words_and_sounds_as_without_them():
    hibari = pytest.importorskip("hibari")
    said = voice._hibari()("Look at me, please.", "en")
    assert [text for text, _, _ in said.words] == ["Look", "at", "me,", "please."]
    assert all(0 <= start < end <= len(said.samples) / SAMPLE_RATE_HZ for _, start, end in said.words)
    assert np.array_equal(said.samples, hibari.Hibari(threads=1)("Look at me, please.", seed=0))


def test_nano_speaks_five_languages():
    pytest.importorskip("py_nanotts")
    made = [voice._nano()("Maria", language).samples for language in ("en", "de", "es", "fr", "it")]
    assert all(len(samples) > 0.2 * SAMPLE_RATE_HZ and 0.1 < abs(samples).max() < 0.99 for samples in made)


def test_a_service_speaks(only, monkeypatch):
    asked = []

    def act(handler):
        asked.append((handler.path, handler.given.get("authorization"), json.loads(handler.body)))
        handler.answer(200, wav_of(beep("a").samples))

    with running(HttpServer(act)) as server:
        given = {"ECHOAVATAR_VOICE_URL": f"{server.url}/v1", "ECHOAVATAR_VOICE_KEY": "sk-1"}
        only(("service", "", lambda: voice._service(given)))
        (said,) = speak("Hello.")
    assert len(said.samples) > 2_000
    asked_for = {"model": "tts-1", "voice": "alloy", "input": "Hello.", "response_format": "wav"}
    assert asked == [("/v1/audio/speech", "Bearer sk-1", asked_for)]
    with pytest.raises(KeyError):
        voice._service({})


@pytest.fixture
def client(only):
    only(("parrot", "", lambda: beep))
    settings = ServerSettings(token="secret", origins=("https://friend.example",))
    manager = SimpleNamespace(settings=settings, clients=ClientLimits(ClientRates(), settings.token))
    return TestClient(Starlette(routes=[voice_route(manager)]), headers={"authorization": "Bearer secret"})


def test_says_which_voice_there_is(client):
    told = client.get("/v1/voice").json()
    install = "pip install 'echoavatar[voice]'"
    assert told == {"voice": "parrot", "voices": ["parrot"], "max_letters": 600, "install": install}


def test_speaks(client):
    answer = client.post("/v1/voice", json={"text": "hello"})
    samples, rate = soundfile.read(io.BytesIO(answer.content))
    assert (rate, len(samples) > 12_000) == (SAMPLE_RATE_HZ, True)
    assert answer.headers["content-type"] == "audio/wav"


def test_pages_that_may_connect_read_what_it_says(client):
    def told(origin):
        asked = {"access-control-request-method": "POST", "access-control-request-headers": "content-type"}
        before = client.options("/v1/voice", headers={"origin": origin, **asked})
        said = client.post("/v1/voice", json={"text": "hello"}, headers={"origin": origin, "host": "127.0.0.1:8765"})
        return before.status_code, said.status_code, said.headers.get("access-control-allow-origin")

    friend, here = "https://friend.example", "http://127.0.0.1:5500"  # named by --origin; of this machine
    assert told(friend) == (200, 200, friend)
    assert told(here) == (200, 200, here)
    assert told("https://stranger.example") == (400, 403, None)
    assert told("http://localhost.stranger.example") == (400, 403, None)


def test_speaks_sentence_by_sentence_with_words(client):
    answer = client.post("/v1/voice", json={"text": "Hello. Look!", "stream": True})
    first, second = (json.loads(line) for line in answer.content.splitlines())
    assert second["words"] == [{"text": "Look!", "start": 0.5, "end": 0.6}]
    assert base64.b64decode(first["wav"])[:4] == b"RIFF"


def test_a_failure_after_the_first_sentence_is_told(only, client):
    def fail_later(text, _):
        return beep(text) if text == "Hello." else 1 / 0

    only(("parrot", "", lambda: fail_later))
    answer = client.post("/v1/voice", json={"text": "Hello. Look!", "stream": True})
    assert "parrot could not say that" in json.loads(answer.content.splitlines()[-1])["error"]
    assert client.post("/v1/voice", json={"text": "Look!", "stream": True}).status_code == 400


def test_without_a_voice_it_says_what_to_install(only, client):
    only()
    assert client.get("/v1/voice").json()["voice"] == ""
    answer = client.post("/v1/voice", json={"text": "hello"})
    assert (answer.status_code, "pip install 'echoavatar[voice]'" in answer.text) == (404, True)


def test_invalid_requests_are_refused(client):
    assert client.post("/v1/voice", json={"text": "x"}, headers={"authorization": "Bearer no"}).status_code == 401
    assert client.post("/v1/voice", data={"text": "x"}).status_code == 400
    for kind in ("text/plain; x=json", "application/x-www-form-urlencoded; application/json", ""):
        answer = client.post("/v1/voice", content=b'{"text": "x"}', headers={"content-type": kind})
        assert answer.status_code == 400, "a page of anyone can send this without asking"
    answer = client.post("/v1/voice", json={"text": "x"}, headers={"origin": "https://evil.example"})
    assert answer.status_code == 403
    wrong = (b"{", b"[]", b'{"text": 3}', b'{"text": "' + b"x" * 9000 + b'"}', b'{"text": "\\ud800"}', b"[" * 4500)
    for body in wrong:
        answer = client.post("/v1/voice", content=body, headers={"content-type": "application/json"})
        assert answer.status_code == 400, body[:20]
