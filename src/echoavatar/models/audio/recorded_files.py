"""Folders of recorded speech and music: which files they hold, who is heard, and what may be trained on.

A folder may have a `manifest.csv` with the columns path, seconds, kind ("speech" or "music"), speaker_or_artist,
title, language_or_genre and split ("train", "dev" or "test"), one row a file. Settings and weights are chosen on "dev";
"test" is heard once, for a card. `recorded_splits` moves known speakers and artists. Without a manifest every file
belongs to all splits, and a path that contains "music" is music.

Decoded sound is kept as 16-bit arrays in a cache folder, so that any second of a long file is read without decoding
the whole. May import `io`, `nn.kernels`, `timing` and `errors`.
"""

import csv
import hashlib
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int16

from echoavatar.errors import AudioError
from echoavatar.nn.kernels import user_cache

from .io import read_audio
from .recorded_splits import split_of

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
    split: Literal["train", "dev", "test"]
    seconds: float  # 0: not known before it is decoded


def recorded_files(folder: Path, split: str | None = None) -> tuple[RecordedFile, ...]:
    """The recordings of a folder by path, of one `split` or of all; "dev" is "test" where a manifest marks no "dev".

    Raises:
        AudioError: the manifest is damaged or names a file that is missing, or nothing is found.
    """
    manifest = folder / MANIFEST
    if manifest.is_file():
        listed = list(_listed(manifest))
        chosen = [one for one in listed if split in (None, one.split)]
        if split == "dev" and not chosen:
            chosen = [one for one in listed if one.split == "test"]
        what = f"no recordings marked {split}"
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
        partial = kept.with_suffix(f".{os.getpid()}.part")
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as file:
                np.save(file, samples)
            partial.replace(kept)
        except OSError:  # no cache can be written
            partial.unlink(missing_ok=True)
            return samples
    return np.asarray(np.load(kept, mmap_mode="r", allow_pickle=False))


def _listed(manifest: Path) -> Iterator[RecordedFile]:
    with manifest.open(encoding="utf-8", newline="") as file:
        for number, row in enumerate(csv.DictReader(file), 2):
            path, kind, voice, title, style, split = (row.get(name) or "" for name in _COLUMNS)
            style = style.split(" [")[0]  # without notes on the excerpt
            if kind not in ("speech", "music") or split not in ("train", "dev", "test"):
                raise AudioError(
                    f"{manifest}, line {number}: kind is {kind!r} and split {split!r}; write speech or music, and "
                    "train, dev or test"
                )
            inside = manifest.parent / path
            if not inside.is_file() or not inside.resolve().is_relative_to(manifest.parent.resolve()):
                raise AudioError(f"{manifest}, line {number}: {path!r} is no file of this folder; mend the line")
            seconds = float(row.get("seconds") or 0)
            yield RecordedFile(inside, kind, voice, title, style, split_of(voice, split), seconds)  # type: ignore[arg-type]


def _found(folder: Path) -> Iterator[RecordedFile]:
    for path in folder.rglob("*"):
        if path.suffix.lower() in AUDIO_SUFFIXES:
            is_music = "music" in str(path.relative_to(folder)).lower()
            yield RecordedFile(path, "music" if is_music else "speech", "", path.stem, "", "train", 0.0)
