"""Table "Quantitative evaluation on test set" of the paper: corruption and its absence, beside baselines.

The paper has no uniform corruption; MECo, EDGE and the tuned models are quoted.
"""

from typing import NamedTuple

from echoavatar.evaluation.baselines import Baselines, Kind
from echoavatar.evaluation.scale import Scale
from echoavatar.kinematics import Motion

from .choices import OURS, GeneratorChoice
from .scores import GENERATION, generated
from .table import Cell, Column, Line, Table, cells
from .workshop import LONGER, Workshop, motion_of

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
    """A line with a generator of ours."""

    name: str
    paper: tuple[float, ...]
    generator: GeneratorChoice


VARIANTS = (
    Variant(
        "Ours (w/o corrupt)",
        (25.92, 29.58, 8.464, 2.541),
        GeneratorChoice("corruption-none", training={"corruption": "none"}),
    ),
    Variant(
        "Ours (uniform corruption)",
        (),
        GeneratorChoice("corruption-uniform", training={"corruption": "uniform"}),
    ),
    Variant(
        "Ours (hierarchical corruption)",
        (9.465, 20.70, 8.277, 2.603),
        GeneratorChoice(OURS.name),  # that of the tokenizer ablation's last line
    ),
)


def offline(scale: Scale) -> GeneratorChoice:
    """The upper reference: ours, hearing half of its window before it is due; trained on as much sound a window."""
    window = scale.generator.window_chunks
    ahead = window // 2
    return GeneratorChoice(
        "offline", sizes={"ahead_chunks": ahead}, training={"chunks": window + LONGER - ahead}
    )


def make(workshop: Workshop) -> Table:
    """Train what is missing, score, tabulate."""
    keys = ("fid", "diversity", "ba_g", "ba_d")
    truth = _scored(workshop, [motion_of(clip) for clip in workshop.tests])
    lines = [Line("GT", dict(zip(keys, TRUTH, strict=True)), truth)]
    baselines = Baselines(workshop.trained_on)
    for name, kind in BASELINES.items():
        workshop.say(f"line: {name}")
        motions = [
            baselines.make(kind, clip.audio, seed=workshop.seed + number)
            for number, clip in enumerate(workshop.tests)
        ]
        lines.append(Line(name, {}, _scored(workshop, motions)))
    for name, paper, choice in VARIANTS:
        workshop.say(f"line: {name}")
        quoted = dict(zip(keys, paper, strict=False))
        lines.append(Line(name, quoted, _scored(workshop, workshop.made(choice))))
    workshop.say(f"line: {OFFLINE}")
    choice = offline(workshop.scale)
    lines.append(Line(OFFLINE, {}, _scored(workshop, workshop.made(choice))))
    lines += [Line(name, dict(zip(keys, values, strict=True))) for name, values in QUOTED.items()]
    notes = (
        "Diversity: L1 deviation from the mean pose, summed over joints, metres; the paper does not give its unit.",
        f"{OFFLINE}: hierarchical corruption, and sound that is heard {choice.sizes['ahead_chunks']} chunks of 0.27 s"
        " before it is due; it cannot stream. An upper reference of ours, not the paper's.",
        "The paper has no uniform corruption; MECo, EDGE, DPO and GRPO are quoted, not made here.",
    )
    return Table(NAME, "Generation (paper, Quantitative evaluation on test set)", COLUMNS, lines, notes)


def _scored(workshop: Workshop, motions: list[Motion]) -> dict[str, Cell]:
    return cells(generated(motions, workshop.tests, workshop.extractor, seed=workshop.seed), GENERATION)
