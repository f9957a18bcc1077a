"""Recorded sounds that the avatar performs, and takes of motion; each has a kind and a class."""

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.engine.pipeline import Pipeline
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.foreign.csv_rows import read_rows
from echoavatar_lab.models.audio.recordings import refuse_shared, split_of
from echoavatar_lab.progress import Progress

from .metrics.liveliness import MUSIC, ROOM_S, SPEECH, Points
from .metrics.tells import judged_points


class Sound(NamedTuple):
    """What the avatar performs, or what the user says while it listens."""

    name: str
    kind: str
    group: str  # class of voice or music
    audio: Float[np.ndarray, " s"]


class Take(NamedTuple):
    """Motion of a person or of the avatar."""

    name: str
    kind: str
    group: str
    motion: Motion
    audio: Float[np.ndarray, " s"] | None = None  # 24 kHz, where it is known


def read_sounds(
    folder: Path,
    seconds: float,
    most: int,
    *,
    class_of: Callable[[dict[str, str]], str] | None = None,
    split: str = "dev",
) -> list[Sound]:
    """Up to `most` sounds of speech and as many of music, `seconds` long, from as many classes as there are.

    A `manifest.csv` (columns path, kind, speaker_or_artist, language_or_genre, split) tells kind and class, and only
    its `split` is used (as `recorded_files` chooses it); `class_of` tells other classes of its rows. Without a
    manifest, a path with "music" in it is music, and folders are classes. Voices of one class are joined until they
    last `seconds`; music is not. Sounds that stay shorter than 20 s are left out.
    Raises EchoAvatarError if nothing is left.
    """
    listed: dict[tuple[str, str], list[Path]] = defaultdict(list)
    for path, kind, group in _listed(folder, class_of or _class, split):
        listed[kind, group].append(path)
    shortest, found = min(float(ROOM_S), seconds), []
    for kind in (SPEECH, MUSIC):
        classes = [
            _filled(paths, kind, group, seconds, shortest) for (of, group), paths in listed.items() if of == kind
        ]
        turns = itertools.zip_longest(*classes)  # one of each class, then the next of each
        found += list(itertools.islice((sound for turn in turns for sound in turn if sound), most))
    if not found:
        raise EchoAvatarError(f"{folder} holds no speech or music of {shortest:g} s; give another --recordings")
    return found


def told_by_path(folder: Path, words: Mapping[str, Sequence[str]]) -> list[tuple[Path, str, str | None]]:
    """Every .bvh below a folder, its path from the folder's name on, in lower case, and the kind that this says.

    `words` are those of each kind; the first kind that has one in the path counts.
    """
    folder = folder.resolve()
    paths = sorted(folder.rglob("*.bvh"))
    said = [path.relative_to(folder.parent).as_posix().lower() for path in paths]
    kinds = [next((kind for kind, own in words.items() if any(word in text for word in own)), None) for text in said]
    return list(zip(paths, said, kinds, strict=True))


def perform(
    pipeline: Pipeline,
    sounds: Sequence[Sound],
    *,
    seed: int = 0,
    options: MotionOptions = FREE,
    progress: Progress | None = None,
) -> list[Take]:
    """The avatar's motion to the sounds, each with a seed of its own; `progress` receives chunks done and in all."""
    seeds = range(seed, seed + len(sounds))
    made = animate_many(pipeline, [sound.audio for sound in sounds], seeds=seeds, options=options, progress=progress)
    return [Take(*sound[:3], one.motion, sound.audio) for sound, one in zip(sounds, made, strict=True)]


def points_of(take: Take, read: Callable[[Motion], Points] = judged_points) -> Points:
    """The take's points as `metrics.tells` measures them, or as `read` does; a MotionError names the take."""
    try:
        return read(take.motion)
    except MotionError as error:
        raise MotionError(f"{take.name}: {error}") from error


def joined(skeleton: Skeleton, chunks: Sequence[MotionChunk]) -> Motion:
    """The chunks of one session as one motion."""
    whole = join(chunks)
    return Motion(skeleton, whole.rotations, whole.root, float(FRAME_RATE_HZ))


def _listed(folder: Path, class_of: Callable[[dict[str, str]], str], split: str) -> list[tuple[Path, str, str]]:
    """Path, kind and class of every sound of a split."""
    if (manifest := folder / "manifest.csv").is_file():
        rows = read_rows(manifest, ("path", "kind", "speaker_or_artist", "language_or_genre"))
        splits = [split_of(row["speaker_or_artist"], row.get("split", "dev")) for row in rows]
        pieces = (row.get("title", "") if row["kind"] == MUSIC else "" for row in rows)
        refuse_shared(manifest, zip((row["speaker_or_artist"] for row in rows), pieces, splits, strict=True))
        heard = "dev" if split == "dev" and "dev" in splits else "test"
        rows = [row for row, own in zip(rows, splits, strict=True) if own == heard]
        return [(folder / row["path"], row["kind"], class_of(row)) for row in rows]
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SOUND_SUFFIXES)
    places = [path.relative_to(folder) for path in paths]
    kinds = [MUSIC if "music" in place.as_posix().lower() else SPEECH for place in places]
    return [(path, kind, place.parent.name) for path, kind, place in zip(paths, kinds, places, strict=True)]


def _class(row: dict[str, str]) -> str:
    """A genre, or a language and, where "(M, ...", "(F, ..." or German "(m31)", "(w08)" tells it, a sex."""
    told = re.split(r"[,\[]", row["language_or_genre"])[0].strip()
    sex = re.search(r"\(([MFmw])[,\d]", row["speaker_or_artist"]) if row["kind"] == SPEECH else None
    return f"{told}, {'male' if sex[1] in 'Mm' else 'female'}" if sex else told


def _filled(paths: Sequence[Path], kind: str, group: str, seconds: float, shortest: float) -> Iterable[Sound]:
    """Sounds of a class, read when they are asked for."""
    wanted, waiting = int(seconds * SAMPLE_RATE_HZ), np.zeros(0, np.float32)
    for number, path in enumerate(paths, 1):
        waiting = np.concatenate([waiting, read_audio(path)])[:wanted]
        is_last = kind == MUSIC or number == len(paths)
        if len(waiting) == wanted or (is_last and len(waiting) >= shortest * SAMPLE_RATE_HZ):
            yield Sound(path.stem, kind, group, waiting)
        if len(waiting) == wanted or is_last:
            waiting = np.zeros(0, np.float32)
