"""How well are recordings labelled? F-measures at 70 ms against truth that no tracker made. Not in the paper.

Truth: synthetic sound, whose labels are known by construction and which is treated as a recording is (room, equaliser,
noise); and short loops of the recordings (`--corpus`), which by construction hold a whole number of beats and begin on
one. How many beats a loop has was counted in spectrograms.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.corpora.music.beat_tracker import track_beats
from echoavatar_lab.corpora.rehearsal.recording_labels import track_from_recording
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.models.audio.recordings import decoded, recorded_files

from .experiment import Experiment
from .table import Cell, Column, Line, Table

NAME = "sound-labels"
COLUMNS = (Column("f", "F at 70 ms", better="higher"), Column("chance", "F of random times", better=""))
STRESSED = 0.45
LOOPS = {
    "loop_amen_full": 16, "loop_amen": 4, "loop_breakbeat": 4, "loop_tabla": 16, "loop_safari": 16, "loop_mika": 16,
    "loop_compus": 16, "loop_mehackit1": 4, "loop_mehackit2": 4, "loop_garzul": 16, "loop_perc1": 4, "loop_perc2": 4,
    "loop_industrial": 2, "POL-aquatic-circus-short": 48, "POL-brave-worm-short": 32, "POL-cactus-land-short": 32,
    "POL-chubby-cat-short": 32, "POL-dream-course-short": 32, "POL-sky-sanctuary-short": 32,
    "POL-snowy-hill-short": 32, "POL-treasure-match-short": 32,
}  # fmt: skip
Times = Sequence[float] | np.ndarray


def make(experiment: Experiment) -> Table:
    """Label everything and compare."""
    if experiment.sources.corpus is None:
        raise EchoAvatarError("reproduce sound-labels reads loops: give a folder with a manifest.csv as --corpus")
    count = {"tiny": 2, "rehearsal": 20, "paper": 40}[experiment.scale.name]
    rng = np.random.default_rng(experiment.seed)
    pairs: dict[str, list[tuple[Times, Times]]] = {}
    first = 800_000 + 1000 * experiment.seed
    for seed in range(first, first + count):
        known = compose_track(seed, 30.0, "speech", split="test")
        found = track_from_recording(known.audio, "speech")
        both = (known, found)
        times: dict[str, list[list[float]]] = {
            "syllables": [[s.vowel for s in one.syllables] for one in both],
            "stresses": [[s.vowel for s in one.syllables if s.prominence >= STRESSED] for one in both],
            "phrases begin": [[begin for begin, _ in one.phrases] for one in both],
            "phrases end": [[end for _, end in one.phrases] for one in both],
        }
        for name, (wanted, given) in times.items():
            pairs.setdefault(f"synthetic speech: {name}", []).append((wanted, given))
        music = compose_track(seed, 30.0, "music", split="test")
        heard = track_from_recording(music.audio, "music")
        pairs.setdefault("synthetic music: beats", []).append((music.beats, heard.beats))
        pairs.setdefault("synthetic music: downbeats", []).append((music.downbeats, heard.downbeats))
    for name, beats, audio, loop_s in _loops(experiment.sources.corpus):
        pairs.setdefault("loops: beats, by ear alone", []).append((beats, track_beats(audio).beats))
        told = track_beats(audio, loop_s=loop_s).beats
        pairs.setdefault("loops: beats, length known", []).append((beats, told))
        experiment.say(f"{name}: {f_measure(beats, told):.2f}")
    lines = [
        Line(
            f"{name} ({len(clips)} clips)",
            {},
            {
                "f": Cell(float(np.mean([f_measure(wanted, given) for wanted, given in clips]))),
                "chance": Cell(float(np.mean([f_measure(wanted, _random(wanted, rng)) for wanted, _ in clips]))),
            },
        )
        for name, clips in pairs.items()
    ]
    notes = ("Mean over clips. With the length known, the beats of a loop are right once their number is.",)
    return Table(NAME, "Labels of recordings", COLUMNS, lines, notes)


def _loops(folder: Path) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """Name, beats, sound of at least 24 s, and length of each loop that the folder has."""
    found = []
    for file in recorded_files(folder):
        if file.path.stem in LOOPS:
            once = decoded(file.path).astype(np.float32) / 32_768
            loop_s = len(once) / SAMPLE_RATE_HZ
            times = int(np.ceil(24 / loop_s))
            beats = np.arange(times * LOOPS[file.path.stem]) * loop_s / LOOPS[file.path.stem]
            found.append((file.path.stem, beats, np.tile(once, times), loop_s))
    return found


def _random(wanted: Times, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, max(wanted, default=1.0), len(wanted))


def f_measure(wanted: Times, given: Times, tolerance_s: float = 0.07) -> float:
    """F-measure of event times in seconds; each event counts once."""
    free = sorted(float(time) for time in given)
    hits = 0
    for time in wanted:
        near = [other for other in free if abs(other - time) <= tolerance_s]
        if near:
            free.remove(min(near, key=lambda other: abs(other - time)))
            hits += 1
    return 2 * hits / max(1, len(wanted) + len(given))
