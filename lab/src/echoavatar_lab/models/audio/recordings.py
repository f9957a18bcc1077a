"""Folders of recorded speech and music: which files they hold, who is heard, and what may be trained on.

A folder may have a `manifest.csv` with the columns path, seconds, kind ("speech" or "music"), speaker_or_artist,
title, language_or_genre and split ("train" or "test"), one row a file. Without one every file belongs to both splits,
and a path that contains "music" is music.

Decoded sound is kept as 16-bit arrays in a cache folder, so that any second of a long file is read without decoding
the whole. `AudioPool` holds groups of recordings in memory and draws from them by weight.
"""

import csv
import hashlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int16

from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.models.audio.io import read_audio
from echoavatar.nn.kernels import user_cache
from echoavatar.whole_file import whole_file

AUDIO_SUFFIXES = (".wav", ".ogg", ".flac", ".mp3", ".opus", ".m4a")
MANIFEST = "manifest.csv"
_COLUMNS = ("path", "kind", "speaker_or_artist", "title", "language_or_genre", "split")


class RecordedFile(NamedTuple):
    """A sound file, what it holds and who is heard; `voice` is the speaker or the artist, `style` language or genre."""

    path: Path
    kind: Literal["speech", "music"]
    voice: str
    title: str
    style: str
    split: Literal["train", "test"]
    seconds: float  # 0: not known before it is decoded


def recorded_files(folder: Path, split: str | None = None) -> tuple[RecordedFile, ...]:
    """The recordings of a folder by path, of one `split` or of both.

    Raises:
        AudioError: the manifest is damaged or names a file that is missing, or nothing is found.
    """
    manifest = folder / MANIFEST
    if manifest.is_file():
        what, chosen = f"no recordings marked {split}", [one for one in _listed(manifest) if split in (None, one.split)]
    else:
        what, chosen = f"no sound ({', '.join(AUDIO_SUFFIXES)})", list(_found(folder))
    if not chosen:
        raise AudioError(f"{folder} holds {what}; give another --recordings")
    return tuple(sorted(chosen))


def decoded(path: Path) -> Int16[np.ndarray, " s"]:
    """A file's sound at 24 kHz in 16 bit; pages of it are read when they are used.

    Raises:
        AudioError: the file cannot be read.
    """
    about = path.stat() if path.is_file() else None
    if about is None:
        raise AudioError(f"{path} does not exist; check the path")
    return _opened(path, about.st_size, about.st_mtime_ns)


def to_int16(audio: Float[np.ndarray, " s"]) -> Int16[np.ndarray, " s"]:
    """-1..1 to 16 bit."""
    return np.asarray(np.clip(np.round(audio * 32_768), -32_768, 32_767), np.int16)


@lru_cache(maxsize=256)
def _opened(path: Path, size: int, changed: int) -> Int16[np.ndarray, " s"]:
    name = hashlib.sha256(f"{path.resolve()} {size} {changed}".encode()).hexdigest()[:24]
    kept = user_cache() / "sound" / f"{name}.npy"
    if not kept.is_file():
        samples = to_int16(read_audio(path))
        try:
            with whole_file(kept) as partial:
                kept.parent.mkdir(parents=True, exist_ok=True)
                with partial.open("wb") as file:
                    np.save(file, samples)
        except EchoAvatarError:  # no cache can be written
            return samples
    return np.asarray(np.load(kept, mmap_mode="r", allow_pickle=False))


def _listed(manifest: Path) -> Iterator[RecordedFile]:
    with manifest.open(encoding="utf-8", newline="") as file:
        for number, row in enumerate(csv.DictReader(file), 2):
            path, kind, voice, title, style, split = (row.get(name) or "" for name in _COLUMNS)
            style = style.split(" [")[0]  # without notes on the excerpt
            if kind not in ("speech", "music") or split not in ("train", "test"):
                raise AudioError(
                    f"{manifest}, line {number}: kind is {kind!r} and split {split!r}; write speech or music, and "
                    "train or test"
                )
            inside = manifest.parent / path
            if not inside.is_file() or not inside.resolve().is_relative_to(manifest.parent.resolve()):
                raise AudioError(f"{manifest}, line {number}: {path!r} is no file of this folder; mend the line")
            seconds = float(row.get("seconds") or 0)
            yield RecordedFile(inside, kind, voice, title, style, split, seconds)  # type: ignore[arg-type]


def _found(folder: Path) -> Iterator[RecordedFile]:
    for path in folder.rglob("*"):
        if path.suffix.lower() in AUDIO_SUFFIXES:
            is_music = "music" in str(path.relative_to(folder)).lower()
            yield RecordedFile(path, "music" if is_music else "speech", "", path.stem, "", "train", 0.0)


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
