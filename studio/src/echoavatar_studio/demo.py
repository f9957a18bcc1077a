"""A filled example: two small studies of the default bundle, judged by simulated raters, with places left for you.

The pairwise study has three systems: the bundle's own motion, its motion for another sound (which misses the beats),
and its motion at half the size. The preferences of the raters are invented; the titles of the studies say so.
"""

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from echoavatar.engine import AnimatedSound, animate, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.models.audio import read_audio
from echoavatar.motion.formats.tables import write_npz
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rotations import slerp, unit
from echoavatar.timing import SAMPLE_RATE_HZ

from .clips import Progress, save_sound
from .making import Maker
from .owner_actions import OwnerActions
from .settings import Checks, Keeping, PairwiseStudy, PreferenceStudy, SoundChoice, SystemChoice
from .simulate import Preferences, simulate
from .store import Store
from .tables import Study
from .wire import Category

SECONDS = 6.0
SOUNDS: tuple[tuple[str, str, Category, float], ...] = (
    ("speech 1", "speech.ogg", "gesture", 0.0),
    ("speech 2", "speech.ogg", "gesture", 9.0),
    ("music 1", "music.ogg", "dance", 4.0),
    ("music 2", "music/Warm_Salsa.ogg", "dance", 8.0),
)
PREFERENCES = Preferences(
    worth={"EchoAvatar": 0.5, "Other sound": -0.3, "Half size": -0.2}, of_question={"beat_matching": 1.3}
)
_OTHER = (1, 0, 3, 2)  # number of the sound whose motion "Other sound" shows
_RATERS, _LEFT = 12, 3


def make_demo(maker: Maker, library: Path, *, model: str = "default", progress: Progress) -> list[str]:
    """Make two open studies with answers; return their public names."""
    sounds = make_library(library, model, progress)
    studies: list[PairwiseStudy | PreferenceStudy] = [_pairwise(sounds), _preference(sounds, model)]
    names = []
    for number, settings in enumerate(studies):
        public = maker.begin(settings, by="studio")
        maker.make(public, settings, library, progress=progress)
        progress(1, 1, "raters answer")
        preferences = PREFERENCES if settings.kind == "pairwise" else Preferences(worth={model: 0.0}, noise=0.2)
        actions = OwnerActions(maker, "studio")
        simulate(maker.store, actions, public, preferences, raters=_raters(settings), seed=number, last=3)
        names.append(public)
    return names


def make_library(library: Path, model: str, progress: Progress) -> tuple[SoundChoice, ...]:
    """Write the sounds and the clips of the three systems as an owner would."""
    pipeline = Pipeline(load_bundle(model))
    progress(0, len(SOUNDS), "loading the model")
    pipeline.warm_up()
    made: list[AnimatedSound] = []
    for number, (name, _, _, _) in enumerate(SOUNDS):
        progress(number, len(SOUNDS), f"animating {name}")
        audio = _sound(number)
        save_sound(library / "sounds" / f"{name}.flac", audio)
        made.append(animate(pipeline, in_blocks(audio), seed=number))
    for number, (name, _, _, _) in enumerate(SOUNDS):
        own, other = made[number], made[_OTHER[number]]
        for folder, motion, face in (
            ("EchoAvatar", own.motion, own.face),
            ("Other sound", other.motion, own.face),
            ("Half size", half_size(own.motion), own.face),
        ):
            (library / folder).mkdir(parents=True, exist_ok=True)
            beside = {} if face is None else {"face": face}
            write_npz(library / folder / f"{name}.npz", motion, **beside)
    return tuple(SoundChoice(path=f"sounds/{name}.flac", category=category) for name, _, category, _ in SOUNDS)


def half_size(motion: Motion) -> Motion:
    """Halve the distance of every joint to its mean rotation, and of the root to its mean position."""
    turns = motion.rotations
    signs = np.where((turns * turns[:1]).sum(-1, keepdims=True) < 0, np.float32(-1), np.float32(1))
    halved = slerp(unit((turns * signs).mean(0, keepdims=True)), turns, 0.5)
    root = motion.root.copy()
    root[:, [0, 2]] = root[:, [0, 2]].mean(0) + 0.5 * (root[:, [0, 2]] - root[:, [0, 2]].mean(0))
    return Motion(motion.skeleton, halved, root, motion.fps)


def _sound(number: int) -> "np.ndarray[tuple[int], np.dtype[np.float32]]":
    _, file, _, start = SOUNDS[number]
    with as_file(files("echoavatar") / "assets" / file) as path:
        audio = read_audio(path)
    first = round(start * SAMPLE_RATE_HZ)
    return np.asarray(audio[first : first + round(SECONDS * SAMPLE_RATE_HZ)])


def _pairwise(sounds: tuple[SoundChoice, ...]) -> PairwiseStudy:
    return PairwiseStudy(
        kind="pairwise",
        title="Example: three ways to move (answers are made up)",
        systems=tuple(SystemChoice(name=name, clips=name, group="Example") for name in PREFERENCES.worth),
        sounds=sounds,
        seconds=SECONDS,
        raters=_RATERS + _LEFT,
        tasks_per_rater=8,
        training=1,
        checks=Checks(identical=1, corrupted=1),
    )


def _preference(sounds: tuple[SoundChoice, ...], model: str) -> PreferenceStudy:
    return PreferenceStudy(
        kind="preference",
        title="Example: best and worst of eight (answers are made up)",
        model=model,
        sounds=(sounds[0], sounds[2]),
        length=15,
        raters=9 + _LEFT,
        tasks_per_rater=4,
        training=1,
        checks=Checks(identical=0, corrupted=1),
        keep=Keeping(votes=3),
    )


def _raters(settings: PairwiseStudy | PreferenceStudy) -> int:
    return settings.raters - _LEFT


def is_filled(store: Store) -> bool:
    """Whether the store has studies already."""
    with store.read() as session:
        return session.query(Study).first() is not None
