"""The package of the paper's user study: clips of the compared systems, their sounds and a `study.yaml` for the studio.

The groups are the paper's: systems of `--with` against ours; ours before and after DPO, and before and after GRPO;
trained on speech, on music, on both. Every system moves to every sound. The paper asks about speech-only training on
speech alone and about music-only training on music alone; take those rows of the study's table, by its categories.

The table `dataset-composition` has the last group's rows: the paper asked people for their overall preference (mean
over pairs, -2 to 2); here the same models are scored, on test clips of mostly speech for gesture, of mostly music for
dance. Only the order of the lines can be compared.

Beside it stand two studies after GENEA (Kucherenko et al., ICMI 2023, arXiv 2308.12646), which asks for realism and for
appropriateness apart. `realism.yaml` is muted: which moves more like a human being? The true motion is among the
systems. `appropriateness.yaml` has sound: does a system's motion fit its sound better than the system's own motion to
another sound? Such a mismatch is as lifelike, so liveliness alone wins nothing. All clips show one character; in the
second all faces are neutral.
"""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from echoavatar.models.audio import write_wav
from echoavatar.motion.kinematics import Motion
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab.data import MUSIC, SPEECH, Clip

from .alignment import LINES, tuned
from .experiment import Experiment, with_motion
from .scale import OURS, GeneratorChoice, Part, Variant, generator_waves
from .scores import GENERATION, generation_cells
from .table import Cell, Claim, Column, Line, Table

NAME = "dataset-composition"
COLUMNS = (
    Column("gesture_preference", "Preference, gesture", better="higher"),
    Column("gesture_fid", "FID, gesture"),
    Column("gesture_ba_g", "BA_G", "1/10", better="higher"),
    Column("gesture_ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("dance_preference", "Preference, dance", better="higher"),
    Column("dance_fid", "FID, dance"),
    Column("dance_ba_d", "BA_D", "1/10", better="higher"),
    Column("dance_ba_d_over", "BA_D over chance", "1/10", better="higher"),
)
SHOWN = {"gesture": (SPEECH, ("fid", "ba_g", "ba_g_over")), "dance": (MUSIC, ("fid", "ba_d", "ba_d_over"))}


VARIANTS = (
    Variant("Gesture Only", {"gesture_preference": -0.555}, GeneratorChoice("speech-only", only="speech")),
    Variant("Dance Only", {"dance_preference": -0.323}, GeneratorChoice("music-only", only="music")),
    Variant("Merged", {"gesture_preference": 0.555, "dance_preference": 0.323}, GeneratorChoice(OURS.name)),
)

CLAIMS = (
    Claim("Merged", "Gesture Only", ("gesture_fid", "gesture_ba_g", "gesture_ba_g_over")),
    Claim("Merged", "Dance Only", ("dance_fid", "dance_ba_d", "dance_ba_d_over")),
)
"""Joint training helps both kinds, most of all the beat matching of gestures; the paper asked people."""


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`."""
    return generator_waves([one.generator for one in VARIANTS])


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    lines = []
    for name, paper, choice in VARIANTS:
        experiment.say(f"line: {name}")
        lines.append(Line(name, paper, _scored(experiment, choice)))
    counts = {kind: len(of_kind(experiment.test_clips, domain)) for kind, (domain, _) in SHOWN.items()}
    notes = (
        "Preference: the paper's user study (overall preference); nobody was asked here.",
        f"Test clips: {counts['gesture']} of mostly speech, {counts['dance']} of mostly music.",
        "FID is with the true motion of the same clips; a kind with one clip has no interval.",
    )
    return Table(NAME, "Dataset composition (paper, user study)", COLUMNS, lines, notes, CLAIMS)


def _scored(experiment: Experiment, choice: GeneratorChoice) -> dict[str, Cell]:
    motions = experiment.generated_motions(choice)
    found: dict[str, Cell] = {}
    for kind, (domain, keys) in SHOWN.items():
        chosen = of_kind(experiment.test_clips, domain)
        if chosen:
            wanted = {f"{kind}_{key}": GENERATION[key] for key in keys}
            found |= generation_cells(experiment, motions, wanted, chosen)
    return found


def of_kind(clips: list[Clip], domain: int) -> list[int]:
    """Indices of the clips with more frames of this kind of sound than of the other."""
    other = MUSIC if domain == SPEECH else SPEECH
    return [n for n, clip in enumerate(clips) if np.sum(clip.domain == domain) > np.sum(clip.domain == other)]


SECONDS = 10.0
RATERS = 20
SOTA = "Comparison with SOTA"
Systems = Mapping[str, Sequence[Motion]]


def write_study(experiment: Experiment) -> Path:
    """Make what is missing and write the package; returns the path of its `study.yaml`."""
    folder = experiment.folder / "user-study"
    others = experiment.foreign_motions()  # first: a bad file must be told before hours of training
    groups = _groups(experiment, others)
    if folder.exists():
        shutil.rmtree(folder)
    music = set(of_kind(experiment.test_clips, MUSIC))
    sounds = []
    for number, clip in enumerate(experiment.test_clips):
        category = "dance" if number in music else "gesture"
        path = folder / "sounds" / category / f"{clip.name}.wav"
        make_output_folder(path.parent)
        write_wav(path, clip.audio)
        sounds.append({"path": str(path.relative_to(folder)), "category": category})
    systems = []
    for group, members in groups.items():
        for name, motions in members.items():
            place = Path("clips", _file_safe(f"{group}, {name}"))
            for clip, motion in zip(experiment.test_clips, motions, strict=True):
                with_motion(clip, motion).save(folder / place / f"{clip.name}.npz")
            systems.append({"name": name, "clips": str(place), "group": group})
    shortest = min(clip.seconds for clip in experiment.test_clips)
    study: dict[str, Any] = {
        "kind": "pairwise",
        "title": "Which moves better?",
        "systems": systems,
        "sounds": sounds,
        "seconds": min(SECONDS, float(int(shortest * 10) / 10)),
        "raters": RATERS,
        "seed": experiment.seed,
    }
    _genea(folder, study, systems, experiment)
    return _written(folder / "study.yaml", study)


def _genea(folder: Path, study: Mapping[str, Any], systems: Sequence[dict[str, str]], experiment: Experiment) -> None:
    """Write both studies: of ours, the truth and the systems of others."""
    for clip, motion in zip(experiment.test_clips, experiment.true_motions, strict=True):
        with_motion(clip, motion).save(folder / "clips" / "truth" / f"{clip.name}.npz")
    known = {system["name"]: system["clips"] for system in systems if system["group"] == SOTA}
    ours = next(system["clips"] for system in systems if system["name"] in ("Ours", "Ours, before DPO"))
    known = {"Truth": str(Path("clips", "truth")), "Ours": ours} | {k: v for k, v in known.items() if k != "Ours"}
    realism = [{"name": name, "clips": place, "group": "Realism"} for name, place in known.items()]
    asked = {"title": "Which moves more like a human being?", "muted": True, "questions": ["human_likeness"]}
    _written(folder / "realism.yaml", {**study, **asked} | {"systems": realism})
    fits = []
    for name, place in known.items():
        fits.append({"name": name, "clips": place, "group": name})
        fits.append({"name": f"{name}, mismatched", "mismatched": name, "group": name})
    kinds = [sound["category"] for sound in study["sounds"]]
    sounds = [sound for sound in study["sounds"] if kinds.count(sound["category"]) > 1]
    if sounds:  # a category with one sound has no mismatch
        asked = {"title": "Which fits the sound better?", "questions": ["beat_matching"], "sounds": sounds}
        _written(folder / "appropriateness.yaml", {**study, **asked} | {"systems": fits})


def _written(path: Path, study: Mapping[str, object]) -> Path:
    write_whole(path, yaml.safe_dump(dict(study), sort_keys=False, allow_unicode=True))
    return path


def _groups(experiment: Experiment, others: Systems) -> dict[str, Systems]:
    """Systems by group; only systems of one group are compared, and each name stands once in a study."""
    ours = experiment.generated_motions(GeneratorChoice(OURS.name))
    groups: dict[str, Systems] = {SOTA: {**others, "Ours": ours}} if others else {}
    for method in ("dpo", "grpo"):
        name = LINES[method][0]
        after = tuned(experiment, method).motions
        groups[f"RL Strategy, {method.upper()}"] = {f"Ours, before {method.upper()}": ours, name: after}
    groups["Dataset Composition"] = {one.name: experiment.generated_motions(one.generator) for one in VARIANTS}
    return groups


def _file_safe(text: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in text.lower()).split())
