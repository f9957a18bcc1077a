"""The sources of sounds and motion: files of the owner, and models."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.engine import animate, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.errors import AudioError, EchoAvatarError, MotionError
from echoavatar.files.exports import Take
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import SOUND_SUFFIXES
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.formats.tables import NpzArrays, read_npz
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ
from echoavatar_lab.data import Clip
from echoavatar_lab.models.fingers.clips import on_our_rig

from .clips import Performance, fit
from .settings import SoundChoice, SystemChoice
from .wire import Category


class SoundCut(NamedTuple):
    """A stretch of a sound file."""

    name: str
    stem: str  # name of the file without its suffix
    category: Category
    start: float  # seconds
    audio: Float[np.ndarray, " s"]  # 24 kHz mono


def read_sounds(choices: Sequence[SoundChoice], base: Path, *, seconds: float | None) -> list[SoundCut]:
    """Read `seconds` of every chosen file (None: the whole file); names are made unique.

    Raises:
        AudioError: a file is missing, cannot be read, or is too short.
    """
    cuts: list[SoundCut] = []
    taken: set[str] = set()
    for choice in choices:
        for path in _files(base / choice.path):
            audio = read_audio(path)[round(choice.start * SAMPLE_RATE_HZ) :]
            frames = len(audio) * FRAME_RATE_HZ // SAMPLE_RATE_HZ
            if seconds is not None:
                wanted = round(seconds * FRAME_RATE_HZ)
                if frames < wanted:
                    raise AudioError(
                        f"{path} has {frames / FRAME_RATE_HZ:.1f} s of sound from second {choice.start:g} on, the study"
                        f" shows {seconds:g} s; leave it out, or lower `seconds` or `start`"
                    )
                frames = wanted
            name, count = path.stem, 1
            while name in taken:
                count += 1
                name = f"{path.stem} {count}"
            taken.add(name)
            cuts.append(SoundCut(name, path.stem, choice.category, choice.start, fit(audio, frames)))
    return cuts


# From a cut and its number: motion as long as the cut, and the seed it was made with.
Performer = Callable[[SoundCut, int], tuple[Performance, int | None]]


def perform(system: SystemChoice, base: Path) -> Performer:
    """Open a system, which may load a model; each sound has a seed of its own.

    Raises:
        EchoAvatarError: there is no such bundle or folder.
    """
    if system.clips is not None:
        folder = base / system.clips
        if not folder.is_dir():
            raise MotionError(f"system {system.name!r}: {folder} is not a folder; name one that holds its clips")
        return lambda cut, _: (from_folder(folder, system.name, cut), None)
    assert system.model is not None
    inside = base / system.model
    pipeline = Pipeline(load_bundle(inside if (inside / "generator").is_dir() else system.model))
    pipeline.warm_up()

    def by_model(cut: SoundCut, number: int) -> tuple[Performance, int | None]:
        seed = system.seed * 1_000_003 + number
        made = animate(pipeline, in_blocks(cut.audio), seed=seed)
        return Performance(made.motion, made.face), seed

    return by_model


def from_folder(folder: Path, name: str, cut: SoundCut) -> Performance:
    """A system's motion from the file that is named after the sound file, cut at the same second.

    Raises:
        MotionError: there is no such file, it is damaged, or it is too short.
    """
    paths = [folder / f"{cut.stem}{suffix}" for suffix in (".npz", ".bvh")]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise MotionError(
            f"system {name!r} has no clip {cut.stem}.npz or {cut.stem}.bvh in {folder}; clips are named after the sound"
            " files"
        )
    take = _read(path).at(FRAME_RATE_HZ)
    motion = on_our_rig(take.motion)
    first = round(cut.start * FRAME_RATE_HZ)
    frames = len(cut.audio) * FRAME_RATE_HZ // SAMPLE_RATE_HZ
    if motion.frames < first + frames:
        raise MotionError(
            f"{path} lasts {motion.seconds:.1f} s, the study shows seconds {cut.start:g} to"
            f" {cut.start + frames / FRAME_RATE_HZ:g}; make it for the whole sound"
        )
    face = None if take.face is None else take.face[first : first + frames]
    return Performance(motion.cut(first, first + frames), face)


def _read(path: Path) -> Take:
    """The motion, with the ARKit curves that `animate` wrote beside it."""
    if path.suffix == ".bvh":
        return Take(read_bvh(path))
    try:
        motion = read_npz(path)
    except MotionError:
        return Take(Clip.load(path).motion())
    with NpzArrays(path, MotionError) as stored:
        if "face" not in stored:
            return Take(motion)
        face: Float[np.ndarray, "t 52"] = stored["face"].astype(np.float32)
    is_usable = face.shape == (motion.frames, len(ARKIT_NAMES)) and bool(np.isfinite(face).all())
    return Take(motion, face if is_usable else None)


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = sorted(file for file in path.iterdir() if file.suffix.lower() in SOUND_SUFFIXES)
        if not found:
            raise AudioError(f"{path} holds no sound ({', '.join(SOUND_SUFFIXES)}); name another folder")
        return found
    if not path.is_file():
        raise AudioError(f"there is no sound {path}; name a file or a folder, from the place of study.yaml")
    return [path]


def inside(base: Path, paths: Sequence[str]) -> None:
    """Raise unless every path is below `base`: a study that is set up in the page may read only the library.

    Raises:
        EchoAvatarError: a path leads out of `base`.
    """
    root = base.resolve()
    for path in paths:
        if not (root / path).resolve().is_relative_to(root):
            raise EchoAvatarError(f"{path!r} is not in the studio's library; put it there, or start with --study")
