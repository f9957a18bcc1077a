import io
import os
import shutil
import tempfile
from types import SimpleNamespace

import pytest
import soundfile
from starlette.applications import Starlette
from starlette.testclient import TestClient

from echoavatar.errors import EchoAvatarError
from echoavatar.server import ServerSettings, voice
from echoavatar.server.clients import ClientLimits, ClientRates
from echoavatar.server.voice import find_voice, speak, voice_route

VOICES = [name for name in ("flite", "espeak-ng") if shutil.which(name)]


@pytest.mark.parametrize("name", VOICES)
def test_text_becomes_sound(name):
    samples, rate = soundfile.read(io.BytesIO(speak(name, "Hello there.")))
    longer, _ = soundfile.read(io.BytesIO(speak(name, "Hello there, and hello to all the others as well.")))
    assert 0.3 * rate < len(samples) < len(longer)
    assert abs(samples).max() > 0.05


@pytest.mark.parametrize("name", VOICES)
def test_text_is_never_taken_for_an_option(name):
    samples, rate = soundfile.read(io.BytesIO(speak(name, "-w /etc/passwd --help")))
    assert len(samples) / rate > 0.5


def test_nothing_and_too_much_are_refused():
    for text in ("", "  ", "a" * 601):
        with pytest.raises(EchoAvatarError, match="letters"):
            speak("espeak-ng", text)


def test_without_a_temporary_folder_it_is_one_line(monkeypatch):
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [os.devnull])
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setitem(voice._COMMANDS, "parrot", ())
    with pytest.raises(EchoAvatarError, match="parrot could not say that: .*temporary"):
        speak("parrot", "hello")


def test_a_program_that_fails_is_named(monkeypatch):
    monkeypatch.setitem(voice._COMMANDS, "false", ())
    with pytest.raises(EchoAvatarError, match="false could not"):
        speak("false", "hello")


@pytest.fixture
def client(monkeypatch):
    monkeypatch.setattr(voice, "speak", lambda name, text: f"{name}:{text}".encode())
    monkeypatch.setattr(voice, "find_voice", lambda: "parrot")
    settings = ServerSettings(token="secret")
    manager = SimpleNamespace(settings=settings, clients=ClientLimits(ClientRates(), settings.token))
    return TestClient(Starlette(routes=[voice_route(manager)]), headers={"authorization": "Bearer secret"})


def test_says_which_voice_there_is(client):
    assert client.get("/v1/voice").json() == {"voice": "parrot", "max_letters": 600}


def test_speaks(client):
    answer = client.post("/v1/voice", json={"text": "hello"})
    assert answer.content == b"parrot:hello"
    assert answer.headers["content-type"] == "audio/wav"


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


def test_finds_the_voice_of_this_machine(monkeypatch):
    monkeypatch.setattr(voice.shutil, "which", lambda name: "/bin/espeak" if name == "espeak" else None)
    assert find_voice() == "espeak"
    monkeypatch.setattr(voice.shutil, "which", lambda name: None)
    assert find_voice() == ""
