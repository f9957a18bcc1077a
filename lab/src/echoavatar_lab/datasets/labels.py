"""Labels measured from sound: silence, speech or music per frame, beats and stressed syllables."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.corpora.rehearsal.corpus import domains
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording

from .source import Domain

STRESSED = 0.45  # least prominence of a stressed syllable, as in the rehearsal corpus


def sound_labels(audio: NDArray[np.float32], kind: Domain) -> tuple[NDArray[np.uint8], dict[str, tuple[float, ...]]]:
    """Domain (t,) of each frame, and times in seconds of beats, downbeats and stresses, as in a rehearsal clip.

    Sound that is shorter than two seconds or nearly silent is labelled as silence.
    """
    frames = len(audio) // SAMPLES_PER_FRAME
    if len(audio) < 2 * SAMPLE_RATE_HZ or float(np.abs(audio).max()) < 1e-4:
        return np.zeros(frames, np.uint8), {}
    track = track_from_recording(audio, kind)
    events: dict[str, Sequence[float]] = {
        "beats": track.beats.tolist(),
        "downbeats": track.downbeats.tolist(),
        "stress": [syllable.vowel for syllable in track.syllables if syllable.prominence >= STRESSED],
    }
    end = len(audio) / SAMPLE_RATE_HZ
    kept = {name: tuple(round(time, 4) for time in times if 0 <= time < end) for name, times in events.items()}
    return domains(track, frames), {name: times for name, times in kept.items() if times}
