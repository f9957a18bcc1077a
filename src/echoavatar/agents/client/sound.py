"""Read sound files without torch, at their own rate."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import AudioError


def read_sound(path: str | Path) -> tuple[Float[np.ndarray, " s"], int]:
    """Read a file as mono floats and return them with the sample rate.

    Raises:
        AudioError: the file does not exist or cannot be read.
    """
    import soundfile

    try:
        samples, rate = soundfile.read(path, dtype="float32", always_2d=True)
    except (OSError, RuntimeError) as error:
        raise AudioError(f"cannot read {path}: {error}; give a WAV, FLAC, OGG or MP3 file") from error
    if not len(samples):
        raise AudioError(f"{path} holds no sound")
    return samples.mean(axis=1), int(rate)
