"""Folders of recorded speech and music: their files, the speakers and artists, and the split of each file.

A folder may have a `manifest.csv` with the columns path, seconds, kind ("speech" or "music"), speaker_or_artist,
title, language_or_genre and split ("train", "dev" or "test"), one row a file. Settings and weights are chosen on "dev";
"test" is heard once, for a card. Without a manifest every file belongs to all splits, and a path that contains "music"
is music.

The manifest of the recordings that the default bundle is made with marks "train" and "test", but its "test" has chosen
weights and settings, and eight artists are in both. So the voices of that "test" are DEV, a voice that stood in two
splits goes wholly to one, and TEST holds 12 voices and 12 tracks that were in "train", by speakers and artists who are
nowhere else. Nothing is trained or chosen on TEST. Wolfgang and Theodore Kerr (Wolfgang_) are one person, and
uncredited tracks of FreePD may be Kevin MacLeod's. EmoDB has no voice in TEST, because all of its speakers say the same
ten sentences.

Decoded sound is kept as 16-bit arrays in a cache folder, so that any second of a long file is read without decoding
the whole. `AudioPool` holds groups of recordings in memory and draws from them by weight.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int16

from echoavatar.cache import first_writable, user_caches
from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.models.audio.io import read_audio
from echoavatar.whole_file import make_output_folder, whole_file
from echoavatar_lab.foreign.csv_rows import read_rows

MANIFEST = "manifest.csv"
_COLUMNS = ("path", "kind", "speaker_or_artist", "title", "language_or_genre", "split")


def _names(text: str) -> frozenset[str]:
    return frozenset(" ".join(name.split()) for name in text.split(";"))


TEST = _names("""
    Cocotte; Frédéric Surget; Linda Johnson (f); LibriSpeech 1998 (F, Sonja); LibriSpeech 2033 (M, Filippo
    Gioachin); LibriSpeech 2414 (M, Ashwin Jain); LibriSpeech 2609 (M, Ian Hatley); LibriSpeech 3005 (M, Ken
    Tischler); LibriSpeech 3080 (F, breathe); LibriSpeech 3331 (F, Peggy); LibriSpeech 367 (F, Kathleen Dang);
    LibriSpeech 533 (F, Ana Simao); @emegeme; Alexander Nakarada; Brian Boyko; Dan Knoflicek; Florian Filsinger;
    HorrorPen; Komiku; Tarush Singhal; cynicmusic; rezoner
""")
DEV = _names("""
    EmoDB 03 (m31); LibriSpeech 1034 (M, Kevin O'Coin); LibriSpeech 1098 (F, Merryb); LibriSpeech 1737 (F, Erin
    Hastings); LibriSpeech 196 (M, Stewart Wills); LibriSpeech 1970 (F, Dawn Larsen); LibriSpeech 2007 (F,
    Sheila Morton); LibriSpeech 2092 (F, Elaine Hamby); LibriSpeech 211 (F, shanda_w); LibriSpeech 2289 (M,
    David Kleparek); LibriSpeech 248 (F, Becky Miller); LibriSpeech 2910 (F, Janna); LibriSpeech 2989 (F, Jamie
    Strassenburg, Cypress, California); LibriSpeech 3486 (M, Robin Balmer); LibriSpeech 3807 (M, Jesse Noar);
    LibriSpeech 3857 (M, Epistomolus); LibriSpeech 39 (F, Sherry Crowther); LibriSpeech 3947 (F, johnell);
    LibriSpeech 4014 (M, Tom Clifton); LibriSpeech 445 (M, Dave Foss); LibriSpeech 446 (M, Steve Hartzog);
    LibriSpeech 481 (M, Neal Foley); LibriSpeech 4830 (M, George Aalto); LibriSpeech 5163 (F, LilyAnne);
    LibriSpeech 5390 (M, Charles Bice); LibriSpeech 5688 (F, Jennifer Dionne); LibriSpeech 5703 (M, Garth
    Comira); LibriSpeech 5789 (F, Kirsten Wever); LibriSpeech 6064 (F, Deborah Knight); LibriSpeech 6078 (F,
    dobsonfly); LibriSpeech 6081 (M, Lazuli); LibriSpeech 6181 (M, Mike); LibriSpeech 6476 (F, Viridian);
    LibriSpeech 7067 (M, Matthew Wall); LibriSpeech 7402 (M, Canby Ibarra); LibriSpeech 7447 (M, dasbury);
    LibriSpeech 7780 (F, tazzle); LibriSpeech 7794 (F, mlcui); LibriSpeech 7859 (F, xinamarieuhl); LibriSpeech
    8465 (F, TinaNygard2); LibriSpeech 8629 (M, Shivansh Dhar); dmitri; faber; kathleen; pim; Bryan Teoh; Efface
    Studios; Jason Shaw; Theodore Kerr (Wolfgang_); Wolfgang; qubodup / yd
""")
TRAIN = _names("freesound / Sonic Pi; HoliznaCC0; Kevin MacLeod; PlayOnLoop.com; uncredited (FreePD)")
_SPLITS = {"test": TEST, "dev": DEV, "train": TRAIN}


class RecordedFile(NamedTuple):
    """A sound file with its labels; `voice` is the speaker or the artist, `style` the language or genre."""

    path: Path
    kind: Literal["speech", "music"]
    voice: str
    title: str
    style: str
    split: Literal["train", "dev", "test"]
    seconds: float  # 0: not known before it is decoded


def recorded_files(folder: Path, split: str | None = None) -> tuple[RecordedFile, ...]:
    """The recordings of a folder by path, of one `split` or of all; "dev" is "test" where a manifest marks no "dev".

    Raises AudioError if the manifest is damaged, names a file that is missing or has one voice in two splits, or
    nothing is found.
    """
    manifest = folder / MANIFEST
    if manifest.is_file():
        listed = list(_listed(manifest))
        refuse_shared(manifest, ((one.voice, one.title if one.kind == "music" else "", one.split) for one in listed))
        chosen = [one for one in listed if split in (None, one.split)]
        if split == "dev" and not chosen:
            chosen = [one for one in listed if one.split == "test"]
        what = f"no recordings marked {split}"
    else:
        what, chosen = f"no sound ({', '.join(SOUND_SUFFIXES)})", list(_found(folder))
    if not chosen:
        raise AudioError(f"{folder} holds {what}; give another --recordings")
    return tuple(sorted(chosen))


def split_of(voice: str, listed: str) -> str:
    """The split of a speaker or artist: of the known ones as above, of others as `listed` in their manifest."""
    return next((split for split, names in _SPLITS.items() if voice in names), listed)


def refuse_shared(manifest: Path, listed: Iterable[tuple[str, str, str]]) -> None:
    """Raise AudioError if a speaker, an artist or a piece is in two splits; rows are (voice, piece, split)."""
    at: dict[tuple[str, str], str] = {}
    for voice, piece, split in listed:
        for what, name in (("voice", voice), ("piece", piece)):
            before = at.setdefault((what, " ".join(name.split()).casefold()), split)
            if name and before != split:
                raise AudioError(
                    f"{manifest}: the {what} {name!r} is in {before} and in {split}, so what is held out was heard;"
                    " give all of its files one split"
                )


def decoded(path: Path) -> Int16[np.ndarray, " s"]:
    """A file's sound at 24 kHz in 16 bit; pages of it are read when they are used.

    Raises AudioError if the file cannot be read.
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
    kept = first_writable(*user_caches()) / "sound" / f"{name}.npy"
    if not kept.is_file():
        samples = to_int16(read_audio(path))
        try:
            make_output_folder(kept.parent)
            with whole_file(kept) as partial, partial.open("wb") as file:
                np.save(file, samples)
        except EchoAvatarError:  # no cache can be written
            return samples
    return np.asarray(np.load(kept, mmap_mode="r", allow_pickle=False))


def _listed(manifest: Path) -> Iterator[RecordedFile]:
    for number, row in enumerate(read_rows(manifest, error=AudioError), 2):
        path, kind, voice, title, style, split = (row.get(name, "") for name in _COLUMNS)
        style = style.split(" [")[0]  # without notes on the excerpt
        if kind not in ("speech", "music") or split not in ("train", "dev", "test"):
            raise AudioError(
                f"{manifest}, line {number}: kind is {kind!r} and split {split!r}; write speech or music, and "
                "train, dev or test"
            )
        inside = manifest.parent / path
        if not inside.is_file() or not inside.resolve().is_relative_to(manifest.parent.resolve()):
            raise AudioError(f"{manifest}, line {number}: {path!r} is no file of this folder; mend the line")
        try:
            seconds = float(row.get("seconds") or 0)
        except ValueError as error:
            raise AudioError(f"{manifest}, line {number}: seconds: {error}") from error
        yield RecordedFile(inside, kind, voice, title, style, split_of(voice, split), seconds)  # type: ignore[arg-type]


def _found(folder: Path) -> Iterator[RecordedFile]:
    for path in folder.rglob("*"):
        if path.suffix.lower() in SOUND_SUFFIXES:
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

    Raises AudioError if a file cannot be read, or there is none.
    """
    files = recorded_files(folder, "train")
    return [
        AudioGroup(f"{folder.name}: {kind}", tuple(decoded(file.path) for file in files if file.kind == kind))
        for kind in ("speech", "music")
    ]
