"""The user-study table in the paper's form: rows by group and system, a column for each category and question."""

from collections.abc import Sequence

from .wire import CATEGORIES, Question
from .wire_owner import Mean, ResultRow

TITLES: dict[Question, str] = {
    "human_likeness": "Human Likeness",
    "beat_matching": "Beat Matching",
    "overall_preference": "Overall Preference",
}
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}


def latex_table(rows: Sequence[ResultRow], questions: Sequence[Question], *, caption: str) -> str:
    """A `table*`; its first line names the packages that it needs. A system without judgements has a dash."""
    width = len(questions)
    found = {(row.group, row.system, row.category): row.scores for row in rows}
    systems = list(dict.fromkeys((row.group, row.system) for row in rows))
    heads = " & & ".join(rf"\multicolumn{{{width}}}{{c}}{{{category.capitalize()}}}" for category in CATEGORIES)
    rules = " ".join(rf"\cmidrule(lr){{{first}-{first + width - 1}}}" for first in (3, 4 + width))
    titles = " & & ".join(" & ".join(TITLES[question] for question in questions) for _ in CATEGORIES)
    lines = [
        r"% \usepackage{booktabs, multirow, graphicx}",
        r"\begin{table*}[t]",
        r"\centering",
        rf"\caption{{{escaped(caption)}}}",
        r"\resizebox{\textwidth}{!}{%",
        rf"\begin{{tabular}}{{ll {'c' * width} c {'c' * width}}}",
        r"\toprule",
        rf"\multirow{{2.5}}{{*}}{{Category}} & \multirow{{2.5}}{{*}}{{Method}} & {heads} \\",
        rules,
        rf" & & {titles} \\",
    ]
    for group in dict.fromkeys(group for group, _ in systems):
        names = [name for own, name in systems if own == group]
        lines.append(r"\midrule")
        for place, name in enumerate(names):
            label = rf"\multirow{{{len(names)}}}{{*}}{{{escaped(group)}}}" if place == 0 else ""
            cells = " & & ".join(
                " & ".join(_cell(found.get((group, name, category), {}).get(question)) for question in questions)
                for category in CATEGORIES
            )
            lines.append(rf"{label} & {escaped(name)} & {cells} \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}%", "}", r"\end{table*}", ""])


def escaped(text: str) -> str:
    """Escape the characters that LaTeX treats specially."""
    return "".join(_SPECIAL.get(letter, letter) for letter in " ".join(text.split()))


def _cell(score: Mean | None) -> str:
    if score is None:
        return "-"
    half = "" if score.half is None else rf" \pm {score.half:.3f}"
    return f"${score.mean:.3f}{half}$"
