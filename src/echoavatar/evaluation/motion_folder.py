"""Reads folders of generated motion, true motion and audio, matched by file name.

Motion is `.bvh` of any known rig or `.npz` (clips of a corpus, or output of `animate`), converted to our rig. Audio
comes from a folder of its own, from the clip itself, or from a file of the same name next to the motion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from echoavatar.data import Clip
from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.models.audio import read_audio
from echoavatar.models.fingers.clips import on_our_rig
from echoavatar.motion.kinematics import HUMANOID, Motion, read_bvh
from echoavatar.motion.kinematics.tables import NpzArrays, read_npz
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ, SAMPLE_RATE_HZ

from .behaviour import MUSIC, SPEECH

MOTION_SUFFIXES = (".npz", ".bvh")
AUDIO_SUFFIXES = (".wav", ".ogg", ".flac", ".mp3", ".m4a", ".opus")
_LONGEST_GAP_S = 0.5  # allowed difference in length between audio and motion


class MotionFile(NamedTuple):
    """A file of motion on our rig, with the audio and labels that it contains."""

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
    """How folders are read.

    Attributes:
        audio: folder of audio files; None: from the motion's own files, or next to them.
        needs_audio: a clip without audio is an error; False ignores audio altogether.
        kind: domain of audio without labels, SPEECH or MUSIC; None: music if the path says so, else speech.
        is_common: score only the clips that both folders have.
        is_resampling: convert motion of other rates to 30 fps instead of refusing it.
    """

    audio: Path | None = None
    needs_audio: bool = True
    kind: int | None = None
    is_common: bool = False
    is_resampling: bool = False


def read_pairs(
    made: Path, true: Path, how: ReadOptions, *, progress: Callable[[int, int], None] | None = None
) -> list[Pair]:
    """Every clip that both folders have.

    Raises:
        EchoAvatarError: a folder is missing or empty, clips have no counterpart, or one cannot be used; names it.
    """
    ours, theirs = motion_files(made), motion_files(true)
    names = sorted(ours.keys() & theirs.keys())
    if not how.is_common:
        _want_same(made, ours, true, theirs)
        _want_same(true, theirs, made, ours)
    if not names:
        raise MotionError(f"{made} and {true} have no file name in common; name generated clips like the true ones")
    sounds = _audio_files(how.audio) if how.audio else {}
    pairs = []
    for done, name in enumerate(names, 1):
        pairs.append(_pair(name, ours[name], theirs[name], sounds, how))
        if progress is not None:
            progress(done, len(names))
    return pairs


def motion_files(folder: Path) -> dict[str, Path]:
    """Motion files by stem, from the folder, or from its `clips` if it is a corpus.

    Raises:
        MotionError: the folder does not exist, holds no motion, or has two files of one name.
    """
    if not folder.is_dir():
        raise MotionError(f"{folder} is not a folder; give a folder of .npz or .bvh motion")
    place = folder / "clips" if (folder / "manifest.json").is_file() else folder
    paths = sorted(path for path in place.iterdir() if path.suffix.lower() in MOTION_SUFFIXES)
    if not paths:
        raise MotionError(f"{folder} holds no motion ({', '.join(MOTION_SUFFIXES)}); give another folder")
    found: dict[str, Path] = {}
    for path in paths:
        if path.stem in found:
            raise MotionError(
                f"{folder} has two clips named {path.stem}; keep one of {path.name} and {found[path.stem].name}"
            )
        found[path.stem] = path
    return found


def read_motion_file(path: Path, *, is_resampling: bool = False) -> MotionFile:
    """Read one file.

    Raises:
        MotionError: it cannot be read, holds values that are not finite, or has an unknown rig or another frame rate.
    """
    take = _read(path)
    if abs(take.motion.fps - FRAME_RATE_HZ) > 1e-3 and not is_resampling:
        raise MotionError(
            f"{path} is at {take.motion.fps:g} frames per second, scores are defined at {FRAME_RATE_HZ};"
            " write it at 30, or pass --resample"
        )
    try:
        return take._replace(motion=on_our_rig(take.motion))
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error


def _read(path: Path) -> MotionFile:
    try:
        if path.suffix.lower() == ".bvh":
            return MotionFile(read_bvh(path))
        if _is_clip(path):
            clip = Clip.load(path)
            return MotionFile(
                Motion(HUMANOID, clip.rotations, clip.root, float(FRAME_RATE_HZ)), clip.audio, clip.domain
            )
        return MotionFile(read_npz(path))
    except MotionError as error:
        told = str(error) if path.name in str(error) else f"{path}: {error}"
        raise MotionError(told) from error


def _is_clip(path: Path) -> bool:
    try:
        with NpzArrays(path) as stored:
            return "split" in stored
    except Exception:  # noqa: BLE001  damaged: the reader reports it
        return False


def _pair(name: str, made: Path, true: Path, sounds: dict[str, Path], how: ReadOptions) -> Pair:
    ours = read_motion_file(made, is_resampling=how.is_resampling)
    theirs = read_motion_file(true, is_resampling=how.is_resampling)
    lengths = ours.motion.frames, theirs.motion.frames
    if abs(lengths[0] - lengths[1]) > CHUNK_FRAMES:
        raise MotionError(
            f"clip {name}: {lengths[0]} frames were generated and {lengths[1]} are true; generate the whole clip"
        )
    frames = min(lengths)
    audio = _sound(name, made, true, ours, theirs, sounds) if how.needs_audio else None
    if audio is not None:
        heard, moved = len(audio) / SAMPLE_RATE_HZ, frames / FRAME_RATE_HZ
        if abs(heard - moved) > _LONGEST_GAP_S:
            raise AudioError(
                f"clip {name}: the audio lasts {heard:.2f} s and the motion {moved:.2f} s;"
                " check the motion's frame rate and which audio it belongs to"
            )
    kind = how.kind if how.kind is not None else MUSIC if "music" in f"{true.parent.name}/{name}".lower() else SPEECH
    known = theirs.domain if theirs.domain is not None else ours.domain
    domain = np.full(frames, kind, np.uint8) if known is None or how.kind is not None else known[:frames]
    return Pair(name, ours.motion.cut(0, frames), theirs.motion.cut(0, frames), audio, domain)


def _sound(
    name: str, made: Path, true: Path, ours: MotionFile, theirs: MotionFile, sounds: dict[str, Path]
) -> Float[np.ndarray, " s"]:
    if name in sounds:
        return read_audio(sounds[name])
    for take in (theirs, ours):
        if take.audio is not None:
            return take.audio
    for beside in (true, made):
        for suffix in AUDIO_SUFFIXES:
            if (path := beside.with_suffix(suffix)).is_file():
                return read_audio(path)
    raise AudioError(
        f"clip {name} has no audio; put {name}.wav next to it, give a folder with --audio, or pass --no-audio"
    )


def _audio_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise AudioError(f"{folder} is not a folder; give --audio a folder of audio files")
    found = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in AUDIO_SUFFIXES}
    if not found:
        raise AudioError(f"{folder} holds no audio ({', '.join(AUDIO_SUFFIXES)}); give another --audio")
    return found


def _want_same(here: Path, own: dict[str, Path], there: Path, others: dict[str, Path]) -> None:
    if missing := sorted(others.keys() - own.keys()):
        raise EchoAvatarError(
            f"{here} lacks {len(missing)} of the {len(others)} clips in {there}, for example {missing[0]};"
            " make the rest, or pass --common to score what both have"
        )
