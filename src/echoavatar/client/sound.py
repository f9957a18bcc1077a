"""Sound files without torch: whatever libsndfile reads, at its own rate."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import AudioError


def read_sound(path: str | Path) -> tuple[Float[np.ndarray, " s"], int]:
    """A file as mono floats and its sample rate.

    Raises:
        AudioError: no such file, or none that can be read.
    """
    import soundfile

    try:
        samples, rate = soundfile.read(path, dtype="float32", always_2d=True)
    except (OSError, RuntimeError) as error:
        raise AudioError(f"cannot read {path}: {error}; give a WAV, FLAC, OGG or MP3 file") from error
    if not len(samples):
        raise AudioError(f"{path} holds no sound")
    return samples.mean(axis=1), int(rate)
