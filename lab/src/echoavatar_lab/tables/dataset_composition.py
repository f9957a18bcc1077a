"""Rows "Dataset Composition" of the paper's user study: trained on gesture alone, on dance alone, on both.

The paper asked people for their overall preference (mean over pairs, -2 to 2). Here the same models are scored: on test
clips of mostly speech for gesture, of mostly music for dance. Only the order of the lines can be compared.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from echoavatar_lab.data import MUSIC, SPEECH, Clip

from .choices import OURS, GeneratorChoice
from .experiment import Experiment
from .scores import GENERATION, generation_scores
from .table import Cell, Column, Line, Table, cells
from .waves import Part, generator_waves

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


class Variant(NamedTuple):
    """A line: the preference that the paper reports, and the generator."""

    name: str
    paper: Mapping[str, float]
    generator: GeneratorChoice


VARIANTS = (
    Variant("Gesture Only", {"gesture_preference": -0.555}, GeneratorChoice("speech-only", only="speech")),
    Variant("Dance Only", {"dance_preference": -0.323}, GeneratorChoice("music-only", only="music")),
    Variant("Merged", {"gesture_preference": 0.555, "dance_preference": 0.323}, GeneratorChoice(OURS.name)),
)


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
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
    return Table(NAME, "Dataset composition (paper, user study)", COLUMNS, lines, notes)


def _scored(experiment: Experiment, choice: GeneratorChoice) -> dict[str, Cell]:
    motions = experiment.generated_motions(choice)
    found: dict[str, Cell] = {}
    for kind, (domain, keys) in SHOWN.items():
        chosen = of_kind(experiment.test_clips, domain)
        if chosen:
            rows = generation_scores(
                [motions[number] for number in chosen],
                [experiment.test_clips[number] for number in chosen],
                experiment.extractor,
                seed=experiment.seed,
            )
            wanted = {f"{kind}_{key}": GENERATION[key] for key in keys}
            found |= cells(rows, wanted)
    return found


def of_kind(clips: list[Clip], domain: int) -> list[int]:
    """Indices of the clips with more frames of this kind of sound than of the other."""
    other = MUSIC if domain == SPEECH else SPEECH
    return [n for n, clip in enumerate(clips) if np.sum(clip.domain == domain) > np.sum(clip.domain == other)]
