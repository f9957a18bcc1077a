"""Audio events that motion should answer: speech onsets and music beats, found by librosa as in the paper.

The detectors' settings are part of a published score: 16 kHz, hop 512, defaults otherwise (EMAGE's onsets, and music
beats rounded to 32 ms). The `sharp` forms use beats with a hop of 256 at 24 kHz.
"""

import functools
import getpass
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.errors import DependencyError

EMAGE_RATE_HZ = 16_000


def speech_onsets(audio: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " n"]:
    """Acoustic onsets (s) from librosa's detector with hop 512 and no backtracking."""
    found = _librosa().onset.onset_detect(y=audio, sr=rate, hop_length=512, units="time")
    return np.asarray(found, np.float64)


def music_beats(audio: Float[np.ndarray, " s"], rate: int, *, hop: int = 256) -> Float[np.ndarray, " n"]:
    """Beats (s) from librosa's tracker, for recordings without beat labels."""
    _, times = _librosa().beat.beat_track(y=audio, sr=rate, hop_length=hop, units="time")
    return np.asarray(times, np.float64)


@functools.cache
def _librosa() -> Any:
    """Import librosa with its compiled parts, one process at a time.

    The first import compiles and caches them. If several processes do that at once, numba leaves inconsistent files in
    its cache, and every later process that reads them crashes (numba issue 10128).
    """
    try:
        from filelock import FileLock

        with FileLock(Path(tempfile.gettempdir()) / f"echoavatar-librosa-{getpass.getuser()}.lock"):
            import librosa.beat
            import librosa.onset
    except ImportError as error:
        raise DependencyError("beat alignment needs librosa; run: pip install 'echoavatar-lab'") from error
    return librosa
