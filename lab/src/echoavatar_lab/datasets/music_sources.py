"""Music for the RL corpus: the user's folder, or pieces composed by rule in every style in turn.

The paper uses 100 compositions of many tempos and genres from open platforms (RL Alignment Corpus).
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.models.audio.io import stream_audio
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.corpora.music.instruments import render
from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.music.styles import STYLES
from echoavatar_lab.corpora.rehearsal.augment import set_loudness
from echoavatar_lab.corpora.sound import FloatArray, whole_frames
from echoavatar_lab.data.corpus import checksum
from echoavatar_lab.models.audio.recordings import AUDIO_SUFFIXES

from .labels import sound_labels
from .source import files_below
from .text_to_speech import LOUDNESS_DB

COMPOSED_SECONDS = (60.0, 120.0)
LONGEST_SECONDS = 600.0  # used of a file
SHORTEST_SECONDS = 4.0
TEST_EVERY = 10


class Take(NamedTuple):
    """A finished recording with its labels."""

    audio: FloatArray  # (800 t,) at 24 kHz
    domain: NDArray[np.uint8]  # (t,) 0 silence, 1 speech, 2 music
    events: dict[str, tuple[float, ...]]
    source: str
    licence: str
    notes: dict[str, str]


class Job(NamedTuple):
    """A recording to make; `make` raises AudioError if it cannot be made."""

    name: str
    split: Literal["train", "test"]
    make: Callable[[], Take]


def recorded_music(folder: Path, licence: str) -> Iterator[Job]:
    """One job per sound file of a folder, sorted by path.

    Raises:
        EchoAvatarError: the folder holds no sound.
    """
    paths = files_below(folder, *AUDIO_SUFFIXES)
    if not paths:
        raise EchoAvatarError(f"--music {folder} holds no sound ({', '.join(AUDIO_SUFFIXES)}); name another folder")
    for number, path in enumerate(paths):
        where = path.relative_to(folder)
        stem = "".join(sign if sign.isascii() and sign.isalnum() else "-" for sign in path.stem)[:40]
        name = f"music-{crc32(str(where).encode()):08x}-{stem}"
        yield Job(name, _split(number), partial(_read, path, str(where), licence))


def composed_music(seed: int) -> Iterator[Job]:
    """Endless composed pieces; each follows from the seed and its number."""
    number = 0
    while True:
        yield Job(f"music-own-{seed}-{number:04d}", _split(number), partial(_compose, seed, number))
        number += 1


def _split(number: int) -> Literal["train", "test"]:
    return "test" if number % TEST_EVERY == TEST_EVERY - 1 else "train"


def _read(path: Path, where: str, licence: str) -> Take:
    parts: list[FloatArray] = []
    samples, notes = 0, {}
    for part in stream_audio(path):
        parts.append(part)
        samples += len(part)
        if samples >= LONGEST_SECONDS * SAMPLE_RATE_HZ:
            notes["cut"] = f"after {samples / SAMPLE_RATE_HZ:.0f} s"
            break
    if samples < SHORTEST_SECONDS * SAMPLE_RATE_HZ:
        raise AudioError(f"{where} is shorter than {SHORTEST_SECONDS:.0f} s; choose longer pieces")
    audio = whole_frames(set_loudness(np.concatenate(parts), LOUDNESS_DB))
    domain, events = sound_labels(audio, "music")
    if not domain.any():
        raise AudioError(f"{where} is silent; choose another piece")
    return Take(audio, domain, events, f"{where}, SHA-256 {checksum(path)}", licence, notes)


def _compose(seed: int, number: int) -> Take:
    """Compose a piece; its beats are known exactly."""
    rng = np.random.default_rng([seed, 0x3C5, number])
    piece = compose_piece(rng, float(rng.uniform(*COMPOSED_SECONDS)), list(STYLES)[number % len(STYLES)])
    audio = whole_frames(set_loudness(render(piece, rng), LOUDNESS_DB))
    end = len(audio) / SAMPLE_RATE_HZ
    events = {
        kind: tuple(round(float(time), 4) for time in times if 0 <= time < end)
        for kind, times in (("beats", piece.beats), ("downbeats", piece.downbeats))
    }
    domain = np.full(len(audio) // SAMPLES_PER_FRAME, 2, np.uint8)
    notes = {"style": piece.style, "bpm": f"{piece.bpm:.1f}"}
    return Take(audio, domain, events, "composed by rule", "Apache-2.0", notes)
