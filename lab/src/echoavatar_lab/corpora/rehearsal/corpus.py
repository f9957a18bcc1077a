"""The rehearsal corpus: synthetic pairs of audio and motion, so that the whole pipeline can be trained offline.

Each clip depends only on its own seed: the corpus is the same for any number of workers, and an interrupted run
continues where it stopped. A clip's label "sources" is JSON: [start s, end s, kind, name, style] of each voice and
piece in it; "manner" is JSON of the speaker's `Manner`. The manifest says that the corpus is synthetic.
"""

import json
import multiprocessing
from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator.manner import draw_manner
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.corpora.capture.library import open_library
from echoavatar_lab.data.clip import Clip
from echoavatar_lab.data.corpus import clip_path, write_manifest
from echoavatar_lab.held_folder import hold_folder
from echoavatar_lab.progress import Progress

from ..solver import solve
from ..sound import SoundTrack
from .choreography import choreograph
from .track import compose_track

CLIP_SECONDS = 64.0
TEST_EVERY = 16  # one clip in sixteen is held out


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

    @property
    def clips(self) -> int:
        """Number of clips in the corpus."""
        return max(2, round(self.hours * 3600 / self.clip_seconds))


def rehearse(plan: Plan, *, workers: int = 1, progress: Progress | None = None) -> int:
    """Make or complete the corpus and return its number of clips.

    Raises EchoAvatarError if the folder cannot be written, or hours is not positive.
    """
    if plan.hours <= 0:
        raise EchoAvatarError(f"--hours must be positive, got {plan.hours}")
    with hold_folder(plan.folder):
        make_output_folder(plan.folder / "clips")
        wanted = [i for i in range(plan.clips) if not _path(plan, i).exists()]
        for done, _ in enumerate(_made(plan, wanted, workers), plan.clips - len(wanted) + 1):
            if progress:
                progress(done, plan.clips)
        write_manifest(
            plan.folder,
            {
                "kind": "synthetic rehearsal corpus (motion made by rule over bodies of the library, if there is one)",
                "hours": plan.hours,
                "seed": plan.seed,
                "clip_seconds": plan.clip_seconds,
                "library": plan.library.name if plan.library else None,
                "library_licences": _library(plan.library).credits() if plan.library else None,
                "soundfont": plan.soundfont.name if plan.soundfont else None,
                "recordings": plan.recordings.name if plan.recordings else None,
            },
        )
        return plan.clips


def make_clip(plan: Plan, index: int) -> Clip:
    """Make one clip from the plan's seed and the clip's index."""
    seed = int(np.random.SeedSequence([plan.seed, index]).generate_state(1)[0])
    split = "test" if index % TEST_EVERY == TEST_EVERY - 1 else "train"
    track = compose_track(seed, plan.clip_seconds, split=split, soundfont=plan.soundfont, recordings=plan.recordings)
    rotations, root = solve(choreograph(track, seed, _library(plan.library) if plan.library else None))
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
            "stress": np.array(track.stresses, np.float64),
        },
        split=split,
        labels={
            "sources": json.dumps([[round(s.start, 2), round(s.end, 2), *astuple(s)[2:]] for s in track.sources]),
            "manner": json.dumps({name: round(value, 3) for name, value in asdict(draw_manner(seed)).items()}),
        },
    )


def domains(track: SoundTrack, frames: int) -> NDArray[np.uint8]:
    """Per frame: 0 silence, 1 speech, 2 music."""
    codes = {"silence": 0, "speech": 1, "music": 2}
    domain = np.zeros(frames, np.uint8)
    for span in track.spans:
        domain[round(span.start * FRAME_RATE_HZ) : round(span.end * FRAME_RATE_HZ)] = codes[span.kind]
    return domain


_library = cache(open_library)


def _name(plan: Plan, index: int) -> str:
    return f"rehearsal-{plan.seed}-{index:05d}"


def _path(plan: Plan, index: int) -> Path:
    return clip_path(plan.folder, _name(plan, index))


def _work(plan: Plan, index: int) -> None:
    make_clip(plan, index).save(_path(plan, index))


def _made(plan: Plan, wanted: list[int], workers: int) -> Iterator[None]:
    """Make the wanted clips; yields after each."""
    work = partial(_work, plan)
    if workers <= 1:
        yield from map(work, wanted)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(work, wanted)
