"""The two orders of sound and motion in one sequence: `prefix` (paper, Settings) against `interleaved` (ours).

The paper uses only the first and has no table of them. Here both are trained alike, on the same codes.
"""

from collections.abc import Sequence

from .choices import GeneratorChoice
from .experiment import Experiment
from .scores import GENERATION, generation_scores
from .table import Column, Line, Table, cells
from .waves import Part, generator_waves

NAME = "layouts"
COLUMNS = (
    Column("fid", "FID"),
    Column("diversity", "Diversity", "m", better="higher"),
    Column("ba_g", "BA_G", "1/10", better="higher"),
    Column("ba_g_over", "BA_G over chance", "1/10", better="higher"),
    Column("ba_d", "BA_D", "1/10", better="higher"),
    Column("ba_d_over", "BA_D over chance", "1/10", better="higher"),
)
VARIANTS = {
    "prefix (paper)": GeneratorChoice("order-prefix", sizes={"sequence": "prefix"}),
    "interleaved (ours)": GeneratorChoice("order-interleaved", sizes={"sequence": "interleaved"}),
}


def waves(experiment: Experiment) -> list[Sequence[Part]]:
    """The parts of the table, see `waves`."""
    return generator_waves(list(VARIANTS.values()))


def make(experiment: Experiment) -> Table:
    """Train what is missing, score it and make the table."""
    lines = []
    for name, choice in VARIANTS.items():
        experiment.say(f"line: {name}")
        rows = generation_scores(
            experiment.generated_motions(choice), experiment.test_clips, experiment.extractor, seed=experiment.seed
        )
        lines.append(Line(name, {}, cells(rows, GENERATION)))
    notes = ("The paper has no such table; both lines are ours, trained on the same codes for as many steps.",)
    return Table(NAME, "Order of sound and motion in the sequence", COLUMNS, lines, notes)
