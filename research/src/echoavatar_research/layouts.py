"""The two orders of sound and motion in one sequence: `prefix` (paper, Settings) against `interleaved` (ours).

The paper has the first only and no table on it; both are trained alike here, on the same codes.
"""

from .choices import GeneratorChoice
from .scores import GENERATION, generated
from .table import Column, Line, Table, cells
from .workshop import Workshop

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


def make(workshop: Workshop) -> Table:
    """Train what is missing, score, tabulate."""
    lines = []
    for name, choice in VARIANTS.items():
        workshop.say(f"line: {name}")
        rows = generated(workshop.made(choice), workshop.tests, workshop.extractor, seed=workshop.seed)
        lines.append(Line(name, {}, cells(rows, GENERATION)))
    notes = (
        "The paper has no such table; both lines are ours, trained on the same codes for as many steps.",
    )
    return Table(NAME, "Order of sound and motion in the sequence", COLUMNS, lines, notes)
