"""Reads true and generated motion with its audio from sets and folders, matched by file name; and generates it.

A set is a corpus of either format (`data rehearse`, `data prepare`, `data merge`), of which one split is taken. A
file is `.bvh` of any known rig, `.npz` (a clip, output of `animate`, or SMPL-X parameters as EMAGE writes them) or
`.pkl` (SMPL parameters as EDGE writes them). All of it is converted to our rig. Audio comes from a folder of its own,
from the clip itself, or from a file of the same name next to the motion.

A bundle makes a clip for the sound of every true clip, with a note of how (`made.json`: model, runtime and seed). A
folder is never mixed: with other values it is refused. `score` prints the note of the folder that it scores.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from echoavatar.engine.pipeline import Pipeline
from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import SOUND_SUFFIXES, sound_named
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.smpl import is_smpl
from echoavatar.motion.formats.tables import NpzArrays, read_npz, write_npz
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.motion import resample
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar.whole_file import write_whole
from echoavatar_lab.data import MUSIC, SPEECH, Clip, Corpus
from echoavatar_lab.evaluation.batch import animate_many
from echoavatar_lab.foreign.smpl import read_smpl_pickle, read_smplx
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.models.fingers.clips import on_our_rig
from echoavatar_lab.progress import Progress, watched

MOTION_SUFFIXES = (".npz", ".bvh", ".pkl")
NOTE = "made.json"
BATCH = 16
MADE, TRUE = "res_", "gt_"  # EMAGE writes both into one folder, before the clip's name
EDGES = "test_"  # EDGE writes this before the song's name
_LONGEST_GAP_S = 0.5  # allowed difference in length between audio and motion


class MotionFile(NamedTuple):
    """Motion at 30 frames per second, with the audio and labels that belong to it."""

    motion: Motion
    audio: Float[np.ndarray, " s"] | None = None
    domain: Integer[np.ndarray, " t"] | None = None


@dataclass(frozen=True)
class Pair:
    """Generated and true motion of equal length, our rig at 30 fps; audio at 24 kHz, and the domain of each frame."""

    name: str
    made: Motion
    true: Motion
    audio: Float[np.ndarray, " s"] | None
    domain: Integer[np.ndarray, " t"]


@dataclass(frozen=True)
class ReadOptions:
    """How folders are read."""

    audio: Path | None = None  # folder of audio files; None: from the motion's own files, or next to them
    needs_audio: bool = True  # a clip without audio is an error; False ignores audio altogether
    kind: int | None = None  # of audio without labels, SPEECH or MUSIC; None: music if the path says so, else speech
    is_common: bool = False  # score only the clips that both folders have
    is_resampling: bool = False  # convert motion of other rates to 30 fps instead of refusing it
    split: str | None = "test"  # which clips of a set are taken; None: all of them


@dataclass(frozen=True)
class Source:
    """A clip that can be read: a file, or a clip of a set."""

    path: Path
    corpus: Corpus | None = None
    name: str = ""

    def read(self, *, is_resampling: bool = False) -> MotionFile:
        """Read the clip, see `read_motion_file`."""
        if self.corpus is None:
            return read_motion_file(self.path, is_resampling=is_resampling)
        clip, rig = self.corpus.load(self.name), self.corpus.skeleton_of(self.name)
        motion = on_our_rig(Motion(rig, clip.rotations, clip.root, float(FRAME_RATE_HZ)))
        has_sound = self.corpus.entry(self.name).has_sound
        return MotionFile(motion, clip.audio if has_sound else None, clip.domain if has_sound else None)


def read_pairs(made: Path, true: Path, how: ReadOptions, *, progress: Progress | None = None) -> list[Pair]:
    """Every clip that both folders have.

    Raises:
        EchoAvatarError: a folder is missing or empty, clips have no counterpart, or one cannot be used; names it.
    """
    ours, theirs = sources(made, how.split), sources(true, how.split)
    names = sorted(ours.keys() & theirs.keys())
    if not how.is_common:
        _want_same(made, ours, true, theirs)
        _want_same(true, theirs, made, ours)
    if not names:
        raise MotionError(f"{made} and {true} have no file name in common; name generated clips like the true ones")
    sounds = _audio_files(how.audio) if how.audio else {}
    return [_pair(name, ours[name], theirs[name], sounds, how) for name in watched(names, progress)]


def sound_of(name: str, source: Source, how: ReadOptions) -> Float[np.ndarray, " s"]:
    """The audio of a clip at 24 kHz, as `read_pairs` finds it.

    Raises AudioError if it has none, or it cannot be read.
    """
    sounds = _audio_files(how.audio) if how.audio else {}
    here = (source, source.read(is_resampling=how.is_resampling))
    return _sound(name, here, here, sounds)


def sources(place: Path, split: str | None = "test") -> dict[str, Source]:
    """What a set or a folder holds, by name: of a set the clips of one split (None: of all) that are no mirror images.

    Raises MotionError if the folder does not exist, holds no motion, or has two files of one name; or the set has
    no clip of that split.
    """
    if not (place / "manifest.json").is_file():
        return {name: Source(path) for name, path in motion_files(place).items()}
    corpus = Corpus(place)
    if names := corpus.names(split, has_mirrored=False):
        return {name: Source(place / name, corpus, name) for name in names}
    there = {entry.split for entry in corpus.entries()}
    raise MotionError(
        f"{place} has no clips of split {split!r}, only {', '.join(sorted(there)) or 'none at all'}; name another"
        " --split, or prepare the set again with --test-every 10"
    )


def motion_files(folder: Path) -> dict[str, Path]:
    """Motion files of a folder by the names of their clips: the stem, without what EMAGE or EDGE write before it.

    Raises MotionError if the folder does not exist, holds no motion, or has two files of one name.
    """
    if not folder.is_dir():
        raise MotionError(f"{folder} is not a folder; give a folder of {', '.join(MOTION_SUFFIXES)} motion")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in MOTION_SUFFIXES)
    if any(path.stem.startswith(MADE) for path in paths):
        paths = [path for path in paths if not path.stem.startswith(TRUE)]
    if not paths:
        raise MotionError(f"{folder} holds no motion ({', '.join(MOTION_SUFFIXES)}); give another folder")
    found: dict[str, Path] = {}
    for path in paths:
        name = path.stem.removeprefix(EDGES if path.suffix.lower() == ".pkl" else MADE)
        if name in found:
            raise MotionError(f"{folder} has two clips named {name}; keep one of {path.name} and {found[name].name}")
        found[name] = path
    return found


def read_motion_file(path: Path, *, is_resampling: bool = False, skeleton: Skeleton = HUMANOID) -> MotionFile:
    """Read one file, on our rig or as it is on the rig `skeleton`.

    Raises:
        MotionError: it cannot be read, holds values that are not finite, or has an unknown rig or another frame rate.
    """
    take = _read(path, skeleton)
    if abs(take.motion.fps - FRAME_RATE_HZ) > 1e-3 and not is_resampling:
        raise MotionError(
            f"{path} is at {take.motion.fps:g} frames per second, scores are defined at {FRAME_RATE_HZ};"
            " write it at 30, or pass --resample"
        )
    try:
        return take._replace(motion=_on_rig(take.motion, skeleton))
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error


def _on_rig(motion: Motion, skeleton: Skeleton) -> Motion:
    if skeleton.names == HUMANOID.names:
        return on_our_rig(motion)
    if motion.skeleton.names != skeleton.names:
        raise MotionError(
            f"it has {motion.skeleton.joints} joints ({', '.join(motion.skeleton.names[:3])}, ...), this table is on"
            f" {skeleton.joints} ({', '.join(skeleton.names[:3])}, ...); give motion on those joints"
        )
    return resample(Motion(skeleton, motion.rotations, motion.root, motion.fps), float(FRAME_RATE_HZ))


def _read(path: Path, skeleton: Skeleton) -> MotionFile:
    try:
        match path.suffix.lower():
            case ".bvh":
                return MotionFile(read_bvh(path))
            case ".pkl":
                return MotionFile(read_smpl_pickle(path))
        stored = _stored(path)
        if "split" in stored:
            clip = Clip.load(path)
            motion = Motion(skeleton, clip.rotations, clip.root, float(FRAME_RATE_HZ))
            return MotionFile(motion, clip.audio, clip.domain)
        return MotionFile(read_smplx(path) if is_smpl(stored) else read_npz(path))
    except EchoAvatarError as error:
        told = str(error) if path.name in str(error) else f"{path}: {error}"
        raise MotionError(told) from error


def _stored(path: Path) -> set[str]:
    """The names of a file's arrays; none where it is damaged, which its reader then reports."""
    try:
        with NpzArrays(path) as stored:
            return set(stored)
    except Exception:  # noqa: BLE001
        return set()


def _pair(name: str, made: Source, true: Source, sounds: Mapping[str, Path], how: ReadOptions) -> Pair:
    ours = made.read(is_resampling=how.is_resampling)
    theirs = true.read(is_resampling=how.is_resampling)
    lengths = ours.motion.frames, theirs.motion.frames
    if abs(lengths[0] - lengths[1]) > CHUNK_FRAMES:
        raise MotionError(
            f"clip {name}: {lengths[0]} frames were generated and {lengths[1]} are true; generate the whole clip"
        )
    frames = min(lengths)
    audio = _sound(name, (true, theirs), (made, ours), sounds) if how.needs_audio else None
    if audio is not None:
        heard, moved = len(audio) / SAMPLE_RATE_HZ, frames / FRAME_RATE_HZ
        if abs(heard - moved) > _LONGEST_GAP_S:
            raise AudioError(
                f"clip {name}: the audio lasts {heard:.2f} s and the motion {moved:.2f} s;"
                " check the motion's frame rate and which audio it belongs to"
            )
    told = f"{true.path.parent.name}/{name}".lower()
    kind = how.kind if how.kind is not None else MUSIC if "music" in told else SPEECH
    known = theirs.domain if theirs.domain is not None else ours.domain
    domain = np.full(frames, kind, np.uint8) if known is None or how.kind is not None else known[:frames]
    return Pair(name, ours.motion.cut(0, frames), theirs.motion.cut(0, frames), audio, domain)


def _sound(
    name: str, true: tuple[Source, MotionFile], made: tuple[Source, MotionFile], sounds: Mapping[str, Path]
) -> Float[np.ndarray, " s"]:
    if name in sounds:
        return read_audio(sounds[name])
    for _, take in (true, made):
        if take.audio is not None:
            return take.audio
    for beside, _ in (true, made):
        if path := sound_named(beside.path.with_name(name)):
            return read_audio(path)
    raise AudioError(
        f"clip {name} has no audio; put {name}.wav next to it, give a folder with --audio, or pass --no-audio"
    )


def _audio_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise AudioError(f"{folder} is not a folder; give --audio a folder of audio files")
    found = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in SOUND_SUFFIXES}
    if not found:
        raise AudioError(f"{folder} holds no audio ({', '.join(SOUND_SUFFIXES)}); give another --audio")
    return found


def _want_same(here: Path, own: Mapping[str, Source], there: Path, others: Mapping[str, Source]) -> None:
    if missing := sorted(others.keys() - own.keys()):
        raise EchoAvatarError(
            f"{here} lacks {len(missing)} of the {len(others)} clips in {there}, for example {missing[0]};"
            " make the rest, or pass --common to score what both have"
        )


def make_motion(
    pipeline: Pipeline,
    note: Mapping[str, object],
    true: Path,
    folder: Path,
    how: ReadOptions,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> int:
    """Write `NAME.npz` (our rig or the bundle's, 30 fps) for each true clip's sound; return how many were new.

    Clip k, in order of names, has the seed `seed` + k. Run it again to continue.

    Raises:
        MotionError: the folder holds motion that was made otherwise.
        AudioError: a clip has no sound.
    """
    with hold_folder(folder):
        wanted, known = json.loads(json.dumps(dict(note))), made_how(folder)
        if known is None and any(folder.glob("*.npz")):
            raise MotionError(
                f"{folder} holds motion without {NOTE}, made elsewhere; name a new folder, or drop --model"
            )
        if known is not None and known != wanted:
            raise MotionError(f"{folder} was made with {known}, now asked for {wanted}; name another folder")
        write_whole(folder / NOTE, json.dumps(wanted) + "\n")
        there = sources(true, how.split)
        left = [(number, name) for number, name in enumerate(there) if not (folder / f"{name}.npz").exists()]
        for first in range(0, len(left), BATCH):
            part = left[first : first + BATCH]
            sounds = [sound_of(name, there[name], how) for _, name in part]
            made = animate_many(pipeline, sounds, seeds=[seed + number for number, _ in part])
            for (_, name), one in zip(part, made, strict=True):
                write_npz(folder / f"{name}.npz", one.motion)
            if progress:
                progress(first + len(part), len(left))
        return len(left)


def made_how(folder: Path) -> dict[str, object] | None:
    """The note of a folder; None where it has none, as of other systems. Raises MotionError if the note is damaged."""
    path = folder / NOTE
    try:
        return read_object_file(path)
    except FileNotFoundError:
        return None
    except EchoAvatarError as error:
        raise MotionError(f"{path} is no note of `score --model` or is damaged ({error}); remove it") from error
