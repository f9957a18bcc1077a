"""Training sound: groups of recordings in memory, drawn by weight.

May import `io`, `timing` and `errors`.
"""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int16

from echoavatar.errors import AudioError
from echoavatar.motion.kinematics.tables import NpzArrays

from .io import read_audio

_SOUND = {".wav", ".ogg", ".flac", ".mp3", ".m4a", ".opus"}


class AudioGroup(NamedTuple):
    """Recordings (24 kHz mono, 16 bit) and how often the group is drawn from, relative to the others."""

    name: str
    recordings: tuple[Int16[np.ndarray, " s"], ...]
    weight: float = 1.0


class AudioPool:
    """Draws random pieces of sound; the generator given decides which."""

    def __init__(self, groups: Sequence[AudioGroup]) -> None:
        self.groups = tuple(group for group in groups if group.recordings)
        if not self.groups:
            raise AudioError("no training audio: every folder given is empty; name one with wav, ogg or npz files")
        weights = np.array([group.weight for group in self.groups], float)
        self._chance = weights / weights.sum()
        self._lengths = [np.array([len(one) for one in group.recordings], float) for group in self.groups]

    @property
    def seconds(self) -> dict[str, float]:
        """Sound per group, for the card."""
        return {group.name: float(n.sum() / 24_000) for group, n in zip(self.groups, self._lengths, strict=True)}

    def draw(self, rng: np.random.Generator, samples: int) -> Float[np.ndarray, " s"]:
        """A piece of `samples`; recordings by length, shorter ones are followed by silence."""
        chosen = int(rng.choice(len(self.groups), p=self._chance))
        lengths = self._lengths[chosen]
        recording = self.groups[chosen].recordings[int(rng.choice(len(lengths), p=lengths / lengths.sum()))]
        start = int(rng.integers(0, max(1, len(recording) - samples + 1)))
        piece = recording[start : start + samples].astype(np.float32) / 32_768
        return np.pad(piece, (0, samples - len(piece)))


def read_group(folder: Path, *, weight: float = 1.0) -> AudioGroup:
    """Every sound file of a folder, or the clips of a corpus (`clips/*.npz`, key `audio`).

    Raises:
        AudioError: a file cannot be read.
    """
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SOUND | {".npz"})
    return AudioGroup(folder.name, tuple(to_int16(_read(path)) for path in found), weight)


def to_int16(audio: Float[np.ndarray, " s"]) -> Int16[np.ndarray, " s"]:
    """-1..1 to 16 bit."""
    return np.asarray(np.clip(np.round(audio * 32_768), -32_768, 32_767), np.int16)


def _read(path: Path) -> Float[np.ndarray, " s"]:
    if path.suffix.lower() != ".npz":
        return read_audio(path)
    try:
        with NpzArrays(path, AudioError) as clip:
            audio = clip["audio"]
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise AudioError(f"{path} is not a clip with sound ({error}); make the corpus again") from error
    return np.asarray(audio, np.float32) / (32_768 if audio.dtype == np.int16 else 1)
