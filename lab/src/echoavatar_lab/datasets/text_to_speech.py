"""Text to speech for the scripts of the RL corpus: the local engines of the rehearsal corpus, or an HTTP service.

`openai` is any server that answers `POST URL/audio/speech` as OpenAI does, `elevenlabs` is `POST
URL/text-to-speech/VOICE`. Keys are read from the environment and never written to files or messages. Redirects are not
followed, so that a key is not sent to another host. The paper uses ElevenLabs.
"""

import os
import re
import tempfile
import time
import urllib.parse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from echoavatar import outgoing
from echoavatar.errors import AudioError, DependencyError, EchoAvatarError
from echoavatar.models.audio.io import read_audio
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.rehearsal.corpus import domains
from echoavatar_lab.corpora.sound import FloatArray, SoundTrack, concatenate, whole_frames
from echoavatar_lab.corpora.speech.speech import draw_speaker, resolve_engine, silence, speak

from .conversations import Script, Turn
from .prepare_recording import sound_labels

Service = Literal["auto", "flite", "own", "openai", "elevenlabs"]
LOUDNESS_DB = -25.0
_MOST_CHARACTERS = 2000  # in a request; OpenAI's limit is 4096
_TRIES = 4
_LONGEST_ANSWER = 64 * 2**20
_SECONDS = 120.0


class Spoken(NamedTuple):
    """A spoken script with its labels."""

    audio: FloatArray  # (800 t,) at 24 kHz
    domain: NDArray[np.uint8]  # (t,) 0 silence, 1 speech
    events: dict[str, tuple[float, ...]]
    voices: tuple[str, ...]


class TextToSpeech(Protocol):
    """Speaks scripts."""

    title: str
    licence: str

    def read(self, script: Script, rng: np.random.Generator) -> Spoken:
        """Speak a script; raises AudioError if this one fails, DependencyError if every script would."""


def text_to_speech(
    service: Service, *, url: str | None = None, model: str | None = None, voices: Sequence[str] = ()
) -> TextToSpeech:
    """The engine or service of a name.

    Raises:
        DependencyError: flite is requested and not installed.
        EchoAvatarError: a key or a voice is missing, or the address is not a web address.
    """
    if service in ("auto", "flite", "own"):
        if url or model or voices:
            raise EchoAvatarError(
                f"--tts-url, --tts-model and --voice are for services; --tts {service} has its own voices"
            )
        return LocalTextToSpeech(resolve_engine(service))
    if service == "openai":
        base = (url or os.environ.get("OPENAI_BASE_URL") or "https://api.openai.com/v1").rstrip("/")
        key = _key("OPENAI_API_KEY", is_needed=_host(base) == "api.openai.com")
        headers, named = {"Authorization": f"Bearer {key}"}, model or "gpt-4o-mini-tts"

        def openai(text: str, voice: str) -> tuple[str, dict[str, str]]:
            wanted = {"model": named, "voice": voice, "input": text, "response_format": "wav"}
            return f"{base}/audio/speech", wanted

        return HttpTextToSpeech(
            base, named, voices or ("alloy", "ash", "coral", "sage"), headers if key else {}, openai
        )
    if not voices:
        raise EchoAvatarError("--tts elevenlabs needs --voice with the id of a voice in your library; may be repeated")
    base = (url or "https://api.elevenlabs.io/v1").rstrip("/")
    key = _key("ELEVENLABS_API_KEY", is_needed=_host(base) == "api.elevenlabs.io")
    chosen = model or "eleven_multilingual_v2"

    def elevenlabs(text: str, voice: str) -> tuple[str, dict[str, str]]:
        address = f"{base}/text-to-speech/{urllib.parse.quote(voice, safe='')}?output_format=mp3_44100_128"
        return address, {"text": text, "model_id": chosen}

    return HttpTextToSpeech(base, chosen, voices, {"xi-api-key": key} if key else {}, elevenlabs)


class LocalTextToSpeech:
    """flite or the built-in formant synthesiser; stresses are known exactly."""

    def __init__(self, engine: str) -> None:
        self._engine = engine
        self.title = f"engine {engine}"
        self.licence = "voices: " + ("CMU flite, permissive" if engine == "flite" else "Apache-2.0")

    def read(self, script: Script, rng: np.random.Generator) -> Spoken:
        """See `TextToSpeech`."""
        speakers = [draw_speaker(rng, self._engine) for _ in _speakers(script)]
        tracks: list[SoundTrack] = []
        for number, turn in enumerate(script.turns, start=1):
            if not turn.sentences:
                raise AudioError(
                    f"turn {number} has no word that a local engine can speak; use --tts openai or elevenlabs"
                )
            tracks += [speak(turn.sentences, speakers[turn.speaker], rng, self._engine), _gap(rng)]
        track = concatenate(tracks[:-1])
        stress = tuple(round(time, 4) for time in track.stresses)
        domain = domains(track, len(track.audio) // SAMPLES_PER_FRAME)
        voices = tuple(speaker.voice for speaker in speakers)
        return Spoken(set_loudness(track.audio, LOUDNESS_DB), domain, {"stress": stress}, voices)


class HttpTextToSpeech:
    """A service: one request per piece of a turn, repeated after a pause if the service is busy.

    `ask` gives the address and the content of the request for a text and a voice.
    """

    def __init__(
        self,
        base: str,
        model: str,
        voices: Sequence[str],
        headers: dict[str, str],
        ask: Callable[[str, str], tuple[str, dict[str, str]]],
    ) -> None:
        self._voices, self._headers, self._ask = tuple(voices), headers, ask
        self.pause_s = 2.0  # before the second try; doubles with each further one
        self.title = f"{_host(base)}, {model}"
        self.licence = f"voices: the terms of {_host(base)}"

    def read(self, script: Script, rng: np.random.Generator) -> Spoken:
        """See `TextToSpeech`."""
        order = [str(voice) for voice in rng.permutation(self._voices)]
        speakers = [order[speaker % len(order)] for speaker in _speakers(script)]
        parts: list[FloatArray] = []
        for turn in script.turns:
            parts += [self._say(piece, speakers[turn.speaker]) for piece in _pieces(turn)]
            parts.append(_gap(rng).audio)
        audio = set_loudness(whole_frames(np.concatenate(parts[:-1])), LOUDNESS_DB)
        return Spoken(audio, *sound_labels(audio, "speech"), tuple(dict.fromkeys(speakers)))

    def _say(self, text: str, voice: str) -> FloatArray:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "answer"
            path.write_bytes(self._fetch(*self._ask(text, voice)))
            try:
                return np.asarray(read_audio(path), np.float32)
            except AudioError as error:
                raise AudioError(f"{self.title} sent an answer that is not sound") from error

    def _fetch(self, address: str, content: dict[str, str]) -> bytes:
        for attempt in range(_TRIES):
            try:
                return outgoing.fetch(address, content, headers=self._headers, seconds=_SECONDS, most=_LONGEST_ANSWER)
            except outgoing.OutgoingError as error:
                said = f"{error.status}: {error.said[: outgoing.SHOWN_LETTERS]}" if error.said else str(error.status)
                if error.status in (400, 413, 422):
                    raise AudioError(f"{self.title} refuses the text ({said})") from error
                if error.status != 429 and 0 < error.status < 500:
                    raise DependencyError(
                        f"{self.title} answers {said}; check the key, --tts-url, --tts-model and --voice"
                    ) from error
                trouble = f"answers {said}" if error.status else f"cannot be reached ({error})"
            if attempt + 1 < _TRIES:
                time.sleep(self.pause_s * 2**attempt)
        raise DependencyError(f"{self.title} {trouble}; run again later, finished recordings are kept")


def _key(name: str, *, is_needed: bool) -> str:
    key = os.environ.get(name, "").strip()
    if is_needed and not key:
        raise EchoAvatarError(f"{name} is not set in the environment; export your key, or use --tts flite or own")
    if not key.isascii() or not key.isprintable():
        raise EchoAvatarError(f"{name} has characters that are not allowed in a key; export it again")
    return key


def _host(base: str) -> str:
    parts = urllib.parse.urlsplit(base)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise EchoAvatarError(f"--tts-url {outgoing.redacted(base)} is not a web address; pass http(s)://HOST/v1")
    return parts.hostname


def _speakers(script: Script) -> range:
    return range(1 + max(turn.speaker for turn in script.turns))


def _gap(rng: np.random.Generator) -> SoundTrack:
    """Silence between two turns."""
    return silence(float(rng.uniform(0.2, 0.9)))


def _pieces(turn: Turn) -> list[str]:
    """Split the text into pieces short enough for a request, between sentences if possible."""
    pieces: list[str] = []
    for part in re.split(r"(?<=[.?!])\s+|(?<=[。？！])", turn.text):
        for start in range(0, len(part), _MOST_CHARACTERS):
            text = part[start : start + _MOST_CHARACTERS]
            if pieces and len(pieces[-1]) + len(text) < _MOST_CHARACTERS:
                pieces[-1] += f" {text}"
            else:
                pieces.append(text)
    return pieces
