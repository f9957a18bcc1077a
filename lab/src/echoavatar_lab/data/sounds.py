"""Sound without motion, for tuning a generator by reward (paper, RL Alignment Corpus).

A folder of 24 kHz mono WAV files and `sounds.json`, which holds the labels, origin, terms of use and checksum of each
file. The manifest is rewritten after each recording, so a folder is valid at every moment.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import soundfile
from numpy.typing import NDArray
from pydantic import Field

from echoavatar.config import Config
from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import write_whole

from .corpus import MANIFEST_BYTES, MANIFEST_VALUES, checksum

MANIFEST = "sounds.json"


class Sound(Config):
    """One recording as the manifest lists it."""

    name: str = Field(description="file-safe, unique in its folder")
    file: str = Field(description="path below the folder")
    kind: Literal["speech", "music"] = Field(description="main kind of sound")
    split: Literal["train", "test"] = Field(default="train", description="test: held out of tuning")
    frames: int = Field(gt=0, description="length in motion frames, 30 a second")
    sha256: str = Field(description="checksum of the file")
    source: str = Field(description="origin: text and voices, or the source file")
    licence: str = Field(description="terms of use, as far as known")
    heard: tuple[tuple[int, int], ...] = Field(
        description="runs of (0 silence, 1 speech, 2 music; frames), together `frames`"
    )
    events: dict[str, tuple[float, ...]] = Field(
        default_factory=dict, description="seconds of beats, downbeats, stress"
    )
    notes: dict[str, str] = Field(default_factory=dict, description="style, tempo, text")

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return self.frames * SAMPLES_PER_FRAME / SAMPLE_RATE_HZ

    @property
    def domain(self) -> NDArray[np.uint8]:
        """(t,) per frame: 0 silence, 1 speech, 2 music."""
        kinds, lengths = zip(*self.heard, strict=True)
        return np.repeat(np.array(kinds, np.uint8), lengths)


class SoundSet:
    """A folder of `sounds`, sorted by name; `info` holds the options that made it."""

    def __init__(self, folder: Path) -> None:
        """Raises AudioError if the manifest is missing or damaged."""
        self.folder = folder
        path = folder / MANIFEST
        try:
            stored = read_object_file(path, most=MANIFEST_BYTES, most_values=MANIFEST_VALUES)
            self.info: dict[str, Any] = dict(stored["info"])
            listed = [Sound.model_validate(one) for one in stored["sounds"]]
        except OSError as error:
            raise AudioError(
                f"{folder} holds no sounds: {MANIFEST} is missing; make them with `echoavatar data rl-corpus`"
            ) from error
        except (EchoAvatarError, ValueError, KeyError, TypeError) as error:
            raise AudioError(f"{path} is damaged; delete {folder} and make the sounds again") from error
        self.sounds = sorted(listed, key=lambda sound: sound.name)

    def path(self, sound: Sound) -> Path:
        """Path of a recording's file."""
        return self.folder / sound.file

    def load(self, sound: Sound) -> NDArray[np.float32]:
        """Samples (800 t,) at 24 kHz.

        Raises AudioError if the file is missing, damaged or of another length than listed.
        """
        path = self.path(sound)
        try:
            samples, rate = soundfile.read(path, dtype="float32")
        except (OSError, soundfile.SoundFileError) as error:
            raise AudioError(f"{path} cannot be read ({error}); run the same `data rl-corpus` again") from error
        if rate != SAMPLE_RATE_HZ or samples.shape != (sound.frames * SAMPLES_PER_FRAME,):
            raise AudioError(
                f"{path} holds {samples.shape} samples at {rate} Hz, {MANIFEST} says"
                f" ({sound.frames * SAMPLES_PER_FRAME},) at {SAMPLE_RATE_HZ}; run the same `data rl-corpus` again"
            )
        return np.asarray(samples, np.float32)

    def is_intact(self, sound: Sound) -> bool:
        """Whether a recording's file exists and is unchanged."""
        path = self.path(sound)
        return path.is_file() and checksum(path) == sound.sha256

    def verify(self) -> None:
        """Raise AudioError for the first file that is missing or has changed."""
        for sound in self.sounds:
            if not self.is_intact(sound):
                raise AudioError(f"{self.path(sound)} is missing or changed; run the same `data rl-corpus` again")


def save_sounds(folder: Path, sounds: Iterable[Sound], info: Mapping[str, Any]) -> SoundSet:
    """Write the manifest, completely or not at all."""
    listed = [sound.model_dump(mode="json") for sound in sorted(sounds, key=lambda sound: sound.name)]
    write_whole(folder / MANIFEST, json.dumps({"info": dict(info), "sounds": listed}, indent=1) + "\n")
    return SoundSet(folder)


def runs(domain: NDArray[np.uint8]) -> tuple[tuple[int, int], ...]:
    """Run-length encoding of a domain array: pairs of (kind, frames)."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(domain)) + 1, [len(domain)]])
    return tuple((int(domain[start]), int(stop - start)) for start, stop in zip(edges, edges[1:], strict=False))
