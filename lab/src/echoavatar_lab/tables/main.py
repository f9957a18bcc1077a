"""The paper's table "Quantitative evaluation on test set": kinds of token corruption, beside baselines.

The paper has no uniform corruption and does not score the generator with exemplars. MECo, EDGE and the tuned models are
quoted; motion of other systems (`--with`) is scored like ours.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from echoavatar.motion.kinematics import Motion
from echoavatar_lab.tables.baselines import Baselines, Kind
from echoavatar_lab.tables.scale import Scale

from .choices import OURS, GeneratorChoice
from .experiment import EXTRA_CHUNKS, Experiment, motion_of
from .scores import GENERATION, generation_scores
from .table import Cell, Column, Line, Table, cells
from .waves import Part, generator_waves

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
EXEMPLARS = "Ours, with exemplars (stage 3)"
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


def directed(scale: Scale) -> GeneratorChoice:
    """The generator of the last line, taught control by example (paper, Exemplar-Driven Control).

    In the paper's order by the paper's control tokens, else by our gate.
    """
    form = {"control": "prompt", "example_bias": 0.0} if scale.generator.sequence == "prefix" else {}
    return GeneratorChoice("exemplars", sizes={"exemplar": True} | form, after=GeneratorChoice(OURS.name))


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
    return generator_waves(
        [*(one.generator for one in VARIANTS), directed(experiment.scale), offline(experiment.scale)]
    )


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    keys = ("fid", "diversity", "ba_g", "ba_d")
    truth = _scored(experiment, [motion_of(clip) for clip in experiment.test_clips])
    lines = [Line("GT", dict(zip(keys, TRUTH, strict=True)), truth)]
    others = experiment.foreign_motions()  # first: a bad file must be told before hours of training
    baselines = Baselines(experiment.train_clips)
    for name, kind in BASELINES.items():
        experiment.say(f"line: {name}")
        motions = [
            baselines.make(kind, clip.audio, seed=experiment.seed + number)
            for number, clip in enumerate(experiment.test_clips)
        ]
        lines.append(Line(name, {}, _scored(experiment, motions)))
    for name, motions in others.items():
        experiment.say(f"line: {name}")
        lines.append(Line(name, _quoted(name), _scored(experiment, motions)))
    for name, paper, choice in VARIANTS:
        experiment.say(f"line: {name}")
        quoted = dict(zip(keys, paper, strict=False))
        lines.append(Line(name, quoted, _scored(experiment, experiment.generated_motions(choice))))
    for name, choice in ((EXEMPLARS, directed(experiment.scale)), (OFFLINE, offline(experiment.scale))):
        experiment.say(f"line: {name}")
        lines.append(Line(name, {}, _scored(experiment, experiment.generated_motions(choice))))
    scored = {name.lower() for name in others}
    lines += [Line(f"{name} (quoted)", _quoted(name)) for name in QUOTED if name.lower() not in scored]
    notes = (
        "Diversity: L1 deviation from the mean pose, summed over joints, metres; the paper does not give its unit.",
        f"{OFFLINE}: hierarchical corruption, and sound that is heard {choice.sizes['ahead_chunks']} chunks of 0.27 s"
        " before it is due; it cannot stream. An upper reference of ours, not the paper's.",
        f"{EXEMPLARS}: trained further from the line of hierarchical corruption, given no exemplar here.",
        "The paper has no uniform corruption. Lines marked as quoted are the paper's numbers and nothing else.",
        *foreign_notes(experiment, others),
    )
    return Table(NAME, "Generation (paper, Quantitative evaluation on test set)", COLUMNS, lines, notes)


def foreign_notes(experiment: Experiment, others: Mapping[str, Sequence[Motion]]) -> list[str]:
    """What was scored of other systems: the same clips, and how many of them are cut short."""
    told = []
    for name, motions in others.items():
        short = [clip.frames - motion.frames for motion, clip in zip(motions, experiment.test_clips, strict=True)]
        cut = f"; {sum(map(bool, short))} are short by up to {max(short)} frames and scored as far as they go"
        told.append(
            f"{name}: motion of that system for the same {len(motions)} clips, at 30 frames a second, on the same rig,"
            f" with the same extractor{cut if any(short) else ''}; the paper's numbers beside it are quoted."
        )
    return told


def _quoted(name: str) -> dict[str, float]:
    """The paper's numbers of a system, if it has them."""
    values = next((QUOTED[own] for own in QUOTED if own.lower() == name.lower()), ())
    return dict(zip(("fid", "diversity", "ba_g", "ba_d"), values, strict=False))


def _scored(experiment: Experiment, motions: list[Motion]) -> dict[str, Cell]:
    return cells(
        generation_scores(motions, experiment.test_clips, experiment.extractor, seed=experiment.seed), GENERATION
    )
