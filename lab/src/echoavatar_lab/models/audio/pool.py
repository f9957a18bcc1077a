"""Training sound: groups of recordings in memory, drawn by weight.

May import `recorded_files`, `timing` and `errors`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int16

from echoavatar.errors import AudioError

from .recorded_files import decoded, recorded_files


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


def read_groups(folder: Path) -> list[AudioGroup]:
    """The recordings of a folder that may be trained on: speech and music, each of weight 1.

    Raises:
        AudioError: a file cannot be read, or there is none.
    """
    files = recorded_files(folder, "train")
    return [
        AudioGroup(f"{folder.name}: {kind}", tuple(decoded(file.path) for file in files if file.kind == kind))
        for kind in ("speech", "music")
    ]
