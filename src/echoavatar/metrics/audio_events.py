"""What the ear expects a body to answer: onsets of speech and beats of music, by librosa, as the paper does.

The detectors' settings are part of a published score: 16 kHz, hop 512, defaults otherwise (EMAGE's onsets, and music
beats rounded to 32 ms). `sharp` beats use a hop of 256 at 24 kHz.
"""

import functools
import getpass
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from jaxtyping import Float

from ..errors import DependencyError

EMAGE_RATE_HZ = 16_000


def speech_onsets(audio: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " n"]:
    """Acoustic onsets (s) by librosa's detector with hop 512 and no backtracking."""
    found = _librosa().onset.onset_detect(y=audio, sr=rate, hop_length=512, units="time")
    return np.asarray(found, np.float64)


def music_beats(audio: Float[np.ndarray, " s"], rate: int, *, hop: int = 256) -> Float[np.ndarray, " n"]:
    """Beats (s) by librosa's tracker, for recordings whose beats are not known."""
    _, times = _librosa().beat.beat_track(y=audio, sr=rate, hop_length=hop, units="time")
    return np.asarray(times, np.float64)


@functools.cache
def _librosa() -> Any:
    """The library with its compiled parts, imported by one process at a time.

    The first import compiles and caches them. When several processes do that at once, numba leaves files in its cache
    that do not fit together, and every later process that reads them crashes (numba issue 10128).
    """
    try:
        with FileLock(Path(tempfile.gettempdir()) / f"echoavatar-librosa-{getpass.getuser()}.lock"):
            import librosa.beat
            import librosa.onset
    except ImportError as error:
        raise DependencyError(
            "beat alignment needs librosa; run: pip install 'echoavatar[evaluate]'"
        ) from error
    return librosa
