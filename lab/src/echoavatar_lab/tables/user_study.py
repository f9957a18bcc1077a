"""The package of the paper's user study: clips of the compared systems, their sounds and a `study.yaml` for the studio.

The groups are the paper's: systems of `--with` against ours; ours before and after DPO, and before and after GRPO;
trained on speech, on music, on both. Every system moves to every sound. The paper asks about speech-only training on
speech alone and about music-only training on music alone; take those rows of the study's table, by its categories.
"""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from echoavatar.models.audio import write_wav
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.data import MUSIC, Clip

from . import dataset_composition
from .alignment import LINES, tuned
from .choices import OURS, GeneratorChoice
from .dataset_composition import of_kind
from .experiment import Experiment, with_motion

SECONDS = 10.0
RATERS = 20
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
        path.parent.mkdir(parents=True, exist_ok=True)
        write_wav(path, clip.audio)
        sounds.append({"path": str(path.relative_to(folder)), "category": category})
    systems = []
    for group, members in groups.items():
        for name, motions in members.items():
            place = Path("clips", _file_safe(f"{group}, {name}"))
            _write_clips(folder / place, motions, experiment.test_clips)
            systems.append({"name": name, "clips": str(place), "group": group})
    shortest = min(clip.seconds for clip in experiment.test_clips)
    study = {
        "kind": "pairwise",
        "title": "Which moves better?",
        "systems": systems,
        "sounds": sounds,
        "seconds": min(SECONDS, float(int(shortest * 10) / 10)),
        "raters": RATERS,
        "seed": experiment.seed,
    }
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(study, sort_keys=False, allow_unicode=True), encoding="utf-8")
    return path


def _groups(experiment: Experiment, others: Systems) -> dict[str, Systems]:
    """Systems by group; only systems of one group are compared, and each name stands once in a study."""
    ours = experiment.generated_motions(GeneratorChoice(OURS.name))
    groups: dict[str, Systems] = {"Comparison with SOTA": {**others, "Ours": ours}} if others else {}
    for method in ("dpo", "grpo"):
        name = LINES[method][0]
        after = tuned(experiment, method).motions
        groups[f"RL Strategy, {method.upper()}"] = {f"Ours, before {method.upper()}": ours, name: after}
    groups["Dataset Composition"] = {
        one.name: experiment.generated_motions(one.generator) for one in dataset_composition.VARIANTS
    }
    return groups


def _write_clips(folder: Path, motions: Sequence[Motion], clips: Sequence[Clip]) -> None:
    for motion, clip in zip(motions, clips, strict=True):
        with_motion(clip, motion).save(folder / f"{clip.name}.npz")


def _file_safe(text: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in text.lower()).split())
