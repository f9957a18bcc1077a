"""The paper's table "Quantitative evaluation on test set": kinds of token corruption, beside baselines.

The paper has no uniform corruption. MECo, EDGE and the tuned models are quoted, not run.
"""

from typing import NamedTuple

from echoavatar.motion.kinematics import Motion
from echoavatar_research.baselines import Baselines, Kind
from echoavatar_research.scale import Scale

from .choices import OURS, GeneratorChoice
from .experiment import EXTRA_CHUNKS, Experiment, motion_of
from .scores import GENERATION, generation_scores
from .table import Cell, Column, Line, Table, cells

NAME = "main"
COLUMNS = (
    Column("fid", "FID"),
    Column("diversity", "Diversity", better="higher"),
    Column("ba_g", "BA_G", "1/10", better="higher"),
    Column("ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("ba_d", "BA_D", "1/10", better="higher"),
    Column("ba_d_over", "BA_D over chance", "1/10", better="higher"),
)
TRUTH = (0.0, 21.52, 7.775, 2.619)
QUOTED = {
    "MECo": (14.73, 23.13, 7.507, 2.622),
    "EDGE": (18.06, 19.71, 8.190, 2.668),
    "Ours (DPO)": (12.39, 19.67, 8.283, 2.607),
    "Ours (GRPO)": (24.13, 20.89, 8.239, 2.618),
}
OFFLINE = "Ours, offline (hears ahead)"
BASELINES: dict[str, Kind] = {"Mean pose": "mean", "Random clip": "random", "Nearest sound": "nearest"}


class Variant(NamedTuple):
    """A line with one of our generators."""

    name: str
    paper: tuple[float, ...]
    generator: GeneratorChoice


VARIANTS = (
    Variant(
        "Ours (w/o corrupt)",
        (25.92, 29.58, 8.464, 2.541),
        GeneratorChoice("corruption-none", training={"corruption": "none"}),
    ),
    Variant("Ours (uniform corruption)", (), GeneratorChoice("corruption-uniform", training={"corruption": "uniform"})),
    Variant(
        "Ours (hierarchical corruption)",
        (9.465, 20.70, 8.277, 2.603),
        GeneratorChoice(OURS.name),  # the generator of the last line of the tokenizer ablation
    ),
)


def offline(scale: Scale) -> GeneratorChoice:
    """The upper reference: ours with a lookahead of half its window, trained on as much sound per window."""
    window = scale.generator.window_chunks
    ahead = window // 2
    return GeneratorChoice("offline", sizes={"ahead_chunks": ahead}, training={"chunks": window + EXTRA_CHUNKS - ahead})


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    keys = ("fid", "diversity", "ba_g", "ba_d")
    truth = _scored(experiment, [motion_of(clip) for clip in experiment.test_clips])
    lines = [Line("GT", dict(zip(keys, TRUTH, strict=True)), truth)]
    baselines = Baselines(experiment.train_clips)
    for name, kind in BASELINES.items():
        experiment.say(f"line: {name}")
        motions = [
            baselines.make(kind, clip.audio, seed=experiment.seed + number)
            for number, clip in enumerate(experiment.test_clips)
        ]
        lines.append(Line(name, {}, _scored(experiment, motions)))
    for name, paper, choice in VARIANTS:
        experiment.say(f"line: {name}")
        quoted = dict(zip(keys, paper, strict=False))
        lines.append(Line(name, quoted, _scored(experiment, experiment.generated_motions(choice))))
    experiment.say(f"line: {OFFLINE}")
    choice = offline(experiment.scale)
    lines.append(Line(OFFLINE, {}, _scored(experiment, experiment.generated_motions(choice))))
    lines += [Line(name, dict(zip(keys, values, strict=True))) for name, values in QUOTED.items()]
    notes = (
        "Diversity: L1 deviation from the mean pose, summed over joints, metres; the paper does not give its unit.",
        f"{OFFLINE}: hierarchical corruption, and sound that is heard {choice.sizes['ahead_chunks']} chunks of 0.27 s"
        " before it is due; it cannot stream. An upper reference of ours, not the paper's.",
        "The paper has no uniform corruption; MECo, EDGE, DPO and GRPO are quoted, not made here.",
    )
    return Table(NAME, "Generation (paper, Quantitative evaluation on test set)", COLUMNS, lines, notes)


def _scored(experiment: Experiment, motions: list[Motion]) -> dict[str, Cell]:
    return cells(
        generation_scores(motions, experiment.test_clips, experiment.extractor, seed=experiment.seed), GENERATION
    )
