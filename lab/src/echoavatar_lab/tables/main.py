"""The paper's table "Quantitative evaluation on test set": kinds of token corruption, beside baselines.

The paper has no uniform corruption and does not score the generator with exemplars. MECo, EDGE and the tuned models are
quoted; motion of other systems (`--with`) is scored like ours. Not in the paper is the table `layouts`: the two orders
of sound and motion in one sequence, `prefix` (paper, Settings) and `interleaved` (ours).
"""

from collections.abc import Mapping, Sequence

from echoavatar.motion.kinematics import Motion

from .experiment import EXTRA_CHUNKS, Experiment
from .scale import OURS, GeneratorChoice, Part, Scale, Variant, generator_waves
from .scores import GENERATION_COLUMNS, LISTENING, generated_line, generation_cells, papers
from .table import Claim, Line, Table

NAME = "main"
TRUTH = papers(0.0, 21.52, 7.775, 2.619)
QUOTED = {
    "MECo": papers(14.73, 23.13, 7.507, 2.622),
    "EDGE": papers(18.06, 19.71, 8.190, 2.668),
    "Ours (DPO)": papers(12.39, 19.67, 8.283, 2.607),
    "Ours (GRPO)": papers(24.13, 20.89, 8.239, 2.618),
}
NONE, UNIFORM, OURS_LINE = "Ours (w/o corrupt)", "Ours (uniform corruption)", "Ours (hierarchical corruption)"
OFFLINE = "Ours, offline (hears ahead)"
EXEMPLARS = "Ours, with exemplars (stage 3)"


VARIANTS = (
    Variant(
        NONE, papers(25.92, 29.58, 8.464, 2.541), GeneratorChoice("corruption-none", training={"corruption": "none"})
    ),
    Variant(UNIFORM, {}, GeneratorChoice("corruption-uniform", training={"corruption": "uniform"})),
    Variant(
        OURS_LINE,
        papers(9.465, 20.70, 8.277, 2.603),
        GeneratorChoice(OURS.name),  # the generator of the last line of the tokenizer ablation
    ),
)

COLUMNS = (*GENERATION_COLUMNS, LISTENING)
IGNORED = ("fid", "ba_d", "ba_g_over", "ba_d_over", LISTENING.key)
CLAIMS = (
    Claim(OURS_LINE, NONE, IGNORED),  # without it "the model ignores the input condition"
    Claim(NONE, OURS_LINE, ("diversity", "ba_g")),  # and the movements "artificially inflate these metrics"
    Claim(OURS_LINE, UNIFORM, ("fid",)),  # "unlike uniform noise injection"
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
    """The parts of the table, see `scale.generator_waves`."""
    return generator_waves(
        [*(one.generator for one in VARIANTS), directed(experiment.scale), offline(experiment.scale)]
    )


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    lines = [Line("GT", TRUTH, generation_cells(experiment, experiment.true_motions))]
    others = experiment.foreign_motions()  # first: a bad file must be told before hours of training
    lines += [Line(name, {}, generation_cells(experiment, made)) for name, made in experiment.baseline_motions()]
    for name, motions in others.items():
        experiment.say(f"line: {name}")
        lines.append(Line(name, _quoted(name), generation_cells(experiment, motions)))
    more = (Variant(EXEMPLARS, {}, directed(experiment.scale)), Variant(OFFLINE, {}, offline(experiment.scale)))
    lines += [generated_line(experiment, one) for one in (*VARIANTS, *more)]
    scored = {name.lower() for name in others}
    lines += [Line(f"{name} (quoted)", _quoted(name)) for name in QUOTED if name.lower() not in scored]
    notes = (
        "Diversity: L1 deviation from the mean pose, summed over joints, metres; the paper does not give its unit.",
        f"{OFFLINE}: hierarchical corruption, and sound that is heard {more[1].generator.sizes['ahead_chunks']} chunks"
        " of 0.27 s before it is due; it cannot stream. An upper reference of ours, not the paper's.",
        f"{EXEMPLARS}: trained further from the line of hierarchical corruption, given no exemplar here.",
        "The paper has no uniform corruption. Lines marked as quoted are the paper's numbers and nothing else.",
        *foreign_notes(experiment, others),
    )
    title = "Generation (paper, Quantitative evaluation on test set)"
    return Table(NAME, title, COLUMNS, lines, notes, CLAIMS)


def foreign_notes(experiment: Experiment, others: Mapping[str, Sequence[Motion]]) -> list[str]:
    """Notes on the motion of other systems: it is of the same clips, and some of it may be cut short."""
    told = []
    for name, motions in others.items():
        short = [clip.frames - motion.frames for motion, clip in zip(motions, experiment.test_clips, strict=True)]
        cut = f"; {sum(map(bool, short))} are short by up to {max(short)} frames and scored as far as they go"
        told.append(
            f"{name}: motion of that system for the same {len(motions)} clips, at 30 frames a second, on the same rig,"
            f" with the same extractor{cut if any(short) else ''}; the paper's numbers beside it are quoted."
        )
    return told


def _quoted(name: str) -> Mapping[str, float]:
    """The paper's numbers of a system, if it has them."""
    return next((numbers for own, numbers in QUOTED.items() if own.lower() == name.lower()), {})


LAYOUTS = "layouts"
SEQUENCE_ORDERS = {
    "prefix (paper)": GeneratorChoice("order-prefix", sizes={"sequence": "prefix"}),
    "interleaved (ours)": GeneratorChoice("order-interleaved", sizes={"sequence": "interleaved"}),
}


def order_waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `scale.generator_waves`."""
    return generator_waves(list(SEQUENCE_ORDERS.values()))


def make_orders(experiment: Experiment) -> Table:
    """The table `layouts`: the two orders trained alike, on the same codes. The paper uses only the first."""
    lines = [generated_line(experiment, Variant(name, {}, choice)) for name, choice in SEQUENCE_ORDERS.items()]
    notes = (
        "The paper has no such table; both lines are ours, trained on the same codes for as many steps.",
        "Diversity is in metres.",
    )
    return Table(LAYOUTS, "Order of sound and motion in the sequence", COLUMNS, lines, notes)
