"""Text to speech for the page: a voice from a wheel, a program of this machine, or a service that the operator names.

`VOICES` is the table, the best first; what does not load is not offered. No text leaves the machine unless
`ECHOAVATAR_VOICE_URL` says so. A text is said sentence by sentence, so that the first is heard while the next is made.
"""

import base64
import io
import json
import logging
import os
import re
import shutil
import subprocess
import tempfile
import threading
import unicodedata
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import anyio
import anyio.to_thread
import numpy as np
import soundfile
import soxr
from jaxtyping import Float
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from echoavatar import outgoing
from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ

from .clients import refusal
from .session_manager import SessionManager
from .tool_routes import answering, read_json, readable_by_pages

Samples = Float[np.ndarray, " s"]
INSTALL = "pip install 'echoavatar[voice]'"
MAX_LETTERS = 600
PEAK, MOST_GAIN = 0.95, 2.4  # quiet voices are made louder
QUIET, LEAD_SAMPLES = 0.02, 1_200  # a voice begins where it exceeds this share of its peak; 0.05 s before are kept
_SECONDS = 20.0  # for one sentence
_AT_ONCE = 2  # sentences made at the same time
_EARLY_S = 0.06  # Hibari's phonemes are late by this much against a forced alignment
_DURATIONS = "/Cast_32_output_0"  # inside Hibari's model: frames of each phoneme
_TAG = re.compile(r"<[^<>]*>")
_SENTENCE = re.compile(r"(?<!\b[A-Z]\.)(?<!\bDr\.)(?<!\bMr\.)(?<!\bMrs\.)(?<=[.!?…])\s+(?=\S)|\n+")
# Words that are common in one language and in none of the others. A text with too few of them counts as English.
_TELLING = {
    "de": "der das und ist nicht ich ein eine zu mit auf für wir sie auch bin hallo guten danke bitte",
    "es": "el los las y es por para con yo muy pero está hola gracias buenos buenas qué cómo una soy",
    "fr": "le les et est je vous nous pas une des du dans pour avec bonjour merci suis très c'est oui",
    "it": "il gli e è di che non per sono con ciao grazie buongiorno molto una questo della come sì mi",
}
_SCRIPTS = {"CJK": "cmn", "HIRAGANA": "ja", "KATAKANA": "ja", "HANGUL": "ko", "CYRILLIC": "ru", "ARABIC": "ar"}
# Text and sound pass through files, so no text can be taken for an option.
_PROGRAMS: Mapping[str, tuple[str, ...]] = {
    "say": ("-f", "{text}", "-o", "{wav}", "--data-format=LEI16@22050"),
    "flite": ("-voice", "rms", "-f", "{text}", "-o", "{wav}"),
    "espeak-ng": ("-v", "{language}", "-s", "165", "-f", "{text}", "-w", "{wav}"),
    "espeak": ("-v", "{language}", "-s", "165", "-f", "{text}", "-w", "{wav}"),
}
_LOG = logging.getLogger(__name__)
_LOADING = threading.Lock()


class Said(NamedTuple):
    """A spoken sentence, 24 kHz. Words are (text, start, end), seconds from its first sample; some voices have none."""

    samples: Samples
    words: tuple[tuple[str, float, float], ...] = ()


Speak = Callable[[str, str], Said]  # a sentence and its language


class Voice(NamedTuple):
    """A voice that is loaded."""

    name: str
    languages: str  # such as "de es"; empty: any
    speak: Speak


class _Kind(NamedTuple):
    name: str
    languages: str
    load: Callable[[], Speak]  # raises whatever an absent or broken package raises


class _Durations:
    """Hibari's ONNX session, which also remembers the frames of each phoneme of its last run."""

    def __init__(self, path: str) -> None:
        # Protobuf joins a message that comes twice, so these bytes add an output to the graph.
        output = _message(7, _message(12, _message(1, _DURATIONS.encode())))
        options = import_module("onnxruntime").SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        model = Path(path).read_bytes() + output
        self._session = import_module("onnxruntime").InferenceSession(
            model, options, providers=["CPUExecutionProvider"]
        )
        self.last: Any = ()

    def run(self, names: None, given: Mapping[str, Any]) -> list[Any]:
        made: list[Any] = self._session.run(names, given)
        self.last = made.pop()
        return made


def _message(field: int, content: bytes) -> bytes:
    """A field of protobuf: its number and kind, the length of its content in groups of seven bits, the content."""
    length, size = bytearray(), len(content)
    while size > 127:
        length.append(size & 127 | 128)
        size >>= 7
    return bytes([field << 3 | 2, *length, size]) + content


def _hibari() -> Speak:
    hibari = import_module("hibari")
    tts = hibari.Hibari(threads=1)
    try:
        durations: Any = _Durations(tts.model_path)
        tts.sess, normalize = durations, import_module("hibari.g2p.normalize").normalize
    except Exception as error:  # a version other than 0.2: it speaks, without times of words
        _LOG.warning("hibari gives no times of words (%s); the avatar moves to the sound alone", error)
        durations = None
    lock = threading.Lock()

    def speak(text: str, _: str) -> Said:
        with lock:
            parts = [tts.from_phonemes(phonemes, seed=0) for phonemes in tts.phonemize(text)]
            samples = np.concatenate([*parts, np.zeros(0, np.float32)])
            if durations is None or len(parts) != 1:
                return Said(samples)
            tokens = tts.g2p.phonemize_tokens(tts.g2p.tokenize(normalize(text)))
            return Said(samples, _times(tokens, durations.last, tts.vocab, len(samples)))

    speak("Hello.", "en")  # its first call loads more
    return speak


def _times(tokens: Any, frames: Any, vocabulary: Any, size: int) -> tuple[tuple[str, float, float], ...]:
    """Words and their times: tokens up to a space are a word; the model pads the phonemes with one at either end."""
    spelt = ["".join(letter for letter in token.phonemes or "" if letter in vocabulary) for token in tokens]
    spaces = [" " if token.whitespace and at + 1 < len(tokens) else "" for at, token in enumerate(tokens)]
    if len(frames) != len("".join(spelt) + "".join(spaces)) + 2:
        return ()
    edges = np.concatenate([[0], np.cumsum(frames)]) * (size / max(sum(frames), 1) / SAMPLE_RATE_HZ)
    words, text, first, at = [], "", 1, 1
    for token, phonemes, space in zip(tokens, spelt, spaces, strict=True):
        text, at = text + token.text, at + len(phonemes)
        if space or token is tokens[-1]:
            begin, end = (max(float(edges[edge]) - _EARLY_S, 0.0) for edge in (first, at))
            words.append((text, begin, end))
            text, first, at = "", at + 1, at + 1
    return tuple(words)


def _nano() -> Speak:
    nano, lock = import_module("py_nanotts").NanoTTS(), threading.Lock()
    names = {"en": "en-US", "de": "de-DE", "es": "es-ES", "fr": "fr-FR", "it": "it-IT"}

    def speak(text: str, language: str) -> Said:
        with lock:
            sound = nano.speak(text, voice=names[language], volume=0.5)  # at its own volume it clips
        return Said(_at_our_rate(np.frombuffer(sound, "<i2") / np.float32(32768), 16_000))

    return speak


def _program(name: str) -> Speak:
    if not shutil.which(name):
        raise FileNotFoundError(name)

    def speak(text: str, language: str) -> Said:
        with tempfile.TemporaryDirectory() as folder:
            source, wav = Path(folder) / "text.txt", Path(folder) / "speech.wav"
            source.write_text(text + "\n", "utf-8")
            options = [option.format(text=source, wav=wav, language=language) for option in _PROGRAMS[name]]
            subprocess.run([name, *options], check=True, capture_output=True, timeout=_SECONDS)
            return _read(wav.read_bytes())

    return speak


def _service(environment: Mapping[str, str] = os.environ) -> Speak:
    """Any service with OpenAI's `/audio/speech`."""
    url, key = environment["ECHOAVATAR_VOICE_URL"], environment.get("ECHOAVATAR_VOICE_KEY", "")
    address = url.rstrip("/") + "/audio/speech"
    outgoing.origin(address)
    asked = {"model": environment.get("ECHOAVATAR_VOICE_MODEL", "tts-1"), "response_format": "wav"}
    asked["voice"] = environment.get("ECHOAVATAR_VOICE_NAME", "alloy")
    headers = {"authorization": f"Bearer {key}"} if key else {}

    def speak(text: str, _: str) -> Said:
        sound = outgoing.fetch(address, asked | {"input": text}, headers=headers, seconds=_SECONDS, most=32 << 20)
        return _read(sound)

    return speak


VOICES = [
    _Kind("service", "", _service),
    _Kind("hibari", "en", _hibari),
    _Kind("nano", "de es fr it en", _nano),
    _Kind("say", "", lambda: _program("say")),
    _Kind("flite", "en", lambda: _program("flite")),
    _Kind("espeak-ng", "", lambda: _program("espeak-ng")),
    _Kind("espeak", "", lambda: _program("espeak")),
]


def voices() -> list[Voice]:
    """The voices that load here, the best first. The first call loads them, which takes about a second."""
    with _LOADING:
        return _load()


@cache
def _load() -> list[Voice]:
    found = []
    for kind in VOICES:
        try:
            found.append(Voice(kind.name, kind.languages, kind.load()))
        except (ModuleNotFoundError, FileNotFoundError, KeyError):
            pass  # it is not installed, or no service is named
        except Exception as error:
            _LOG.warning("the voice %s does not load: %s", kind.name, error)
    return found


def find_voice() -> str:
    """Name of the voice that speaks English here; empty if there is none."""
    return next((voice.name for voice in voices() if "en" in voice.languages or not voice.languages), "")


def language_of(text: str) -> str:
    """The likely language of a text, by letters or common words: "en" if neither tells, empty for other letters."""
    scripts = [unicodedata.name(letter, "").partition(" ")[0] for letter in text if letter.isalpha()]
    script = max(set(scripts), key=scripts.count, default="LATIN")
    if script != "LATIN":
        return _SCRIPTS.get(script, "")
    said = re.findall(r"[\w']+", text.lower())
    counts = {language: sum(word in words.split() for word in said) for language, words in _TELLING.items()}
    best = max(counts, key=counts.__getitem__)
    return best if counts[best] > len(said) / 8 else "en"


def speak(text: str) -> Iterator[Said]:
    """The sentences of a text, each when it is made.

    Raises:
        EchoAvatarError: the text is empty or too long, no voice speaks its language, or the voice failed.
    """
    if not text.strip() or len(text) > MAX_LETTERS:
        raise EchoAvatarError(f"the text has {len(text)} letters; send words, and at most {MAX_LETTERS} letters")
    language = language_of(text)
    able = [voice for voice in voices() if language and (not voice.languages or language in voice.languages.split())]
    if not able and language in ("en", *_TELLING):
        able = voices()  # an accent is better than silence
    if not able:
        raise EchoAvatarError(f"no voice here speaks the language of {text[:20]!r}; install espeak-ng, or {INSTALL}")
    return _sentences(able[0], text, language)


def _sentences(voice: Voice, text: str, language: str) -> Iterator[Said]:
    spoken, is_first = voice.languages.split(), True
    known = language if language in spoken or not spoken else spoken[0]
    for sentence in _SENTENCE.split(_TAG.sub(" ", text).strip()):
        try:
            samples, words = voice.speak(sentence, known)
        except Exception as error:  # a voice may fail in any way
            raise EchoAvatarError(f"{voice.name} could not say that: {error!s:.300}; try other words") from error
        if len(samples):
            yield _made_ready(Said(samples, words), is_first=is_first)
            is_first = False
    if is_first:
        raise EchoAvatarError(f"{voice.name} has no sound for {text[:20]!r}; write words of a language that it speaks")


def _made_ready(said: Said, *, is_first: bool) -> Said:
    """The sentence at the level of speech, without the silence before the first one."""
    loud = np.abs(said.samples)
    peak = max(float(loud.max()), 1e-3)
    cut = max(int(np.argmax(loud > QUIET * peak)) - LEAD_SAMPLES, 0) if is_first else 0
    words = [
        (text, max(start - cut / SAMPLE_RATE_HZ, 0.0), max(end - cut / SAMPLE_RATE_HZ, 0.0))
        for text, start, end in said.words
    ]
    return Said(said.samples[cut:] * min(MOST_GAIN, PEAK / peak), tuple(words))


def _read(data: bytes) -> Said:
    samples, rate = soundfile.read(io.BytesIO(data), dtype="float32", always_2d=True)
    return Said(_at_our_rate(samples.mean(axis=1), rate))


def _at_our_rate(samples: Samples, rate: int) -> Samples:
    return np.asarray(soxr.resample(samples, rate, SAMPLE_RATE_HZ), np.float32)


def wav_of(samples: Samples) -> bytes:
    """A 16-bit WAV file of sound at 24 kHz."""
    file = io.BytesIO()
    soundfile.write(file, samples, SAMPLE_RATE_HZ, format="WAV", subtype="PCM_16")
    return file.getvalue()


def voice_route(manager: SessionManager) -> Route:
    """GET names the voices, POST of `{"text": ...}` returns a WAV file.

    With `"stream": true` it returns a line of JSON for each sentence: its WAV file in base64, and its words.
    """
    limiter = anyio.CapacityLimiter(_AT_ONCE)

    async def answer(request: Request) -> object:
        there = await anyio.to_thread.run_sync(voices)
        if request.method != "POST":
            name = there[0].name if there else ""
            return {"voice": name, "voices": [v.name for v in there], "max_letters": MAX_LETTERS, "install": INSTALL}
        if not there:
            return refusal(f"no voice here; {INSTALL}, or install espeak-ng or flite", 404)
        message = await read_json(request, manager.settings.origins, most=8 * MAX_LETTERS)
        text = message.get("text")
        if not isinstance(text, str):
            raise EchoAvatarError('send {"text": "..."}')
        made = await anyio.to_thread.run_sync(speak, text, limiter=limiter)
        first = await _next(made, limiter)
        if message.get("stream") is True:
            return StreamingResponse(_lines(first, made, limiter), media_type="application/x-ndjson")
        said = [] if first is None else [first, *await anyio.to_thread.run_sync(list, made, limiter=limiter)]
        return Response(wav_of(np.concatenate([part.samples for part in said])), media_type="audio/wav")

    cors = readable_by_pages(manager.settings.origins, "POST")
    return Route("/v1/voice", answering(manager, answer), methods=["GET", "POST", "OPTIONS"], middleware=[cors])


async def _next(made: Iterator[Said], limiter: anyio.CapacityLimiter) -> Said | None:
    return await anyio.to_thread.run_sync(next, made, None, limiter=limiter)


async def _lines(first: Said | None, made: Iterator[Said], limiter: anyio.CapacityLimiter) -> AsyncIterator[bytes]:
    """Lines of JSON; a failure after the first sentence is a line, too."""
    said = first
    while said is not None:
        words = [{"text": text, "start": start, "end": end} for text, start, end in said.words]
        line = {"wav": base64.b64encode(wav_of(said.samples)).decode(), "words": words}
        yield json.dumps(line).encode() + b"\n"
        try:
            said = await _next(made, limiter)
        except EchoAvatarError as error:
            yield json.dumps({"error": str(error)}).encode() + b"\n"
            return
