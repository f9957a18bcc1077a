"""The rehearsal corpus: synthetic pairs of audio and motion, so that the whole pipeline can be trained offline.

Each clip depends only on its own seed: the corpus is the same for any number of workers, and an interrupted run
continues where it stopped. The manifest says that the corpus is synthetic.
"""

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echoavatar.data.clip import Clip
from echoavatar.data.corpus import clip_path, write_manifest
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio.io import read_audio
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from .augment import set_loudness, treat
from .choreography import choreograph
from .recorded_motion import Library, blend_recordings, load_library
from .recording_labels import track_from_recording
from .solver import solve
from .sound import SoundTrack, concatenate, cut, whole_frames
from .track import compose_track

CLIP_SECONDS = 64.0
TEST_EVERY = 16  # one clip in sixteen is held out
RECORDING_EVERY = 3  # if recordings are given, one clip in three uses them
AUDIO_SUFFIXES = (".wav", ".ogg", ".flac", ".mp3", ".opus", ".m4a")


@dataclass(frozen=True)
class Plan:
    """What to make: total length, seed, output folder, and recorded material to mix in."""

    hours: float
    seed: int
    folder: Path
    library: Path | None = None
    recordings: Path | None = None
    soundfont: Path | None = None
    clip_seconds: float = CLIP_SECONDS
    refine_fingers: bool = False  # give recorded motion with frozen fingers new ones

    @property
    def clips(self) -> int:
        """Number of clips in the corpus."""
        return max(2, round(self.hours * 3600 / self.clip_seconds))


def rehearse(plan: Plan, *, workers: int = 1, progress: Callable[[int, int], None] | None = None) -> int:
    """Make or complete the corpus and return its number of clips.

    Raises:
        EchoAvatarError: the folder cannot be written, or hours is not positive.
    """
    if plan.hours <= 0:
        raise EchoAvatarError(f"--hours must be positive, got {plan.hours}")
    folder = plan.folder / "clips"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EchoAvatarError(
            f"cannot write the corpus to {plan.folder}: {error.strerror}; choose another -o"
        ) from error
    wanted = [i for i in range(plan.clips) if not _path(plan, i).exists()]
    done = plan.clips - len(wanted)
    for _ in _made(plan, wanted, workers):
        done += 1
        if progress:
            progress(done, plan.clips)
    write_manifest(
        plan.folder,
        {
            "kind": "synthetic rehearsal corpus (motion made by rule, not captured)",
            "hours": plan.hours,
            "seed": plan.seed,
            "clip_seconds": plan.clip_seconds,
            "library": plan.library.name if plan.library else None,
            "refine_fingers": plan.refine_fingers,
            "soundfont": plan.soundfont.name if plan.soundfont else None,
            "recordings": plan.recordings.name if plan.recordings else None,
        },
    )
    return plan.clips


def make_clip(plan: Plan, index: int) -> Clip:
    """Make one clip from the plan's seed and the clip's index."""
    seed = int(np.random.SeedSequence([plan.seed, index]).generate_state(1)[0])
    split = "test" if index % TEST_EVERY == TEST_EVERY - 1 else "train"
    track = _track(plan, index, seed, split)
    controls = choreograph(track, seed)
    rotations, root = solve(controls)
    if plan.library is not None:
        motion = Motion(HUMANOID, rotations, root, float(FRAME_RATE_HZ))
        blended = blend_recordings(_library(plan.library, plan.refine_fingers), track, motion, seed)
        rotations, root = blended.rotations, blended.root
    frames = min(len(rotations), len(track.audio) // SAMPLES_PER_FRAME)
    return Clip(
        name=_name(plan, index),
        audio=track.audio[: frames * SAMPLES_PER_FRAME].astype(np.float32),
        rotations=rotations[:frames].astype(np.float32),
        root=root[:frames].astype(np.float32),
        domain=domains(track, frames),
        events={
            "beats": np.asarray(track.beats, np.float64),
            "downbeats": np.asarray(track.downbeats, np.float64),
            "stress": np.array([s.vowel for s in track.syllables if s.prominence >= 0.45], np.float64),
        },
        split=split,
    )


def domains(track: SoundTrack, frames: int) -> NDArray[np.uint8]:
    """Per frame: 0 silence, 1 speech, 2 music."""
    codes = {"silence": 0, "speech": 1, "music": 2}
    domain = np.zeros(frames, np.uint8)
    for span in track.spans:
        domain[round(span.start * FRAME_RATE_HZ) : round(span.end * FRAME_RATE_HZ)] = codes[span.kind]
    return domain


def _track(plan: Plan, index: int, seed: int, split: str) -> SoundTrack:
    if plan.recordings is None or index % RECORDING_EVERY != 1:
        return compose_track(seed, plan.clip_seconds, split=split, soundfont=plan.soundfont)
    return _recorded_track(_recordings(plan.recordings), plan.clip_seconds, seed)


def _recorded_track(recordings: Mapping[str, Sequence[Path]], seconds: float, seed: int) -> SoundTrack:
    """Stretches of recorded speech and music with pauses between them, each augmented differently."""
    rng = np.random.default_rng([seed, 0x2EC])
    level_db = float(np.clip(rng.normal(-25, 6), -40, -14))
    parts: list[SoundTrack] = []
    while sum(part.seconds for part in parts) < seconds:
        kind = str(rng.choice(sorted(recordings)))
        audio = _read(recordings[kind][int(rng.integers(len(recordings[kind])))])
        wanted = int(rng.uniform(10, 26) * SAMPLE_RATE_HZ)
        start = int(rng.integers(0, max(1, len(audio) - wanted)))
        heard = set_loudness(treat(audio[start : start + wanted], rng), level_db + float(rng.normal(0, 2)))
        pause = compose_track(int(rng.integers(2**31)), float(rng.uniform(0.6, 4.5)), mix="silence")
        parts += [track_from_recording(whole_frames(heard), kind, seed), pause]
    return cut(concatenate(parts), seconds)


@cache
def _library(folder: Path, is_refined: bool) -> Library:
    return load_library(folder, is_refined=is_refined)


@cache
def _recordings(folder: Path) -> Mapping[str, Sequence[Path]]:
    """Sound files by kind; a path that contains "music" counts as music, any other as speech."""
    found: dict[str, list[Path]] = {}
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in AUDIO_SUFFIXES):
        kind = "music" if "music" in str(path.relative_to(folder)).lower() else "speech"
        found.setdefault(kind, []).append(path)
    if not found:
        raise EchoAvatarError(f"{folder} holds no sound ({', '.join(AUDIO_SUFFIXES)}); give another --recordings")
    return found


@lru_cache(maxsize=4)
def _read(path: Path) -> NDArray[np.float32]:
    return read_audio(path)


def _name(plan: Plan, index: int) -> str:
    return f"rehearsal-{plan.seed}-{index:05d}"


def _path(plan: Plan, index: int) -> Path:
    return clip_path(plan.folder, _name(plan, index))


def _work(job: tuple[Plan, int]) -> int:
    plan, index = job
    make_clip(plan, index).save(_path(plan, index))
    return index


def _made(plan: Plan, wanted: list[int], workers: int) -> Iterator[int]:
    jobs = [(plan, index) for index in wanted]
    if workers <= 1:
        yield from map(_work, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(_work, jobs)
