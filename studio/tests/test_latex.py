"""The table has the paper's form."""

import shutil
import subprocess

import pytest

from echoavatar_studio.latex import escaped, latex_table
from echoavatar_studio.wire import QUESTIONS
from echoavatar_studio.wire_owner import Mean, ResultRow


def row(system: str, group: str, category: str, *means: float) -> ResultRow:
    scores = {q: Mean(mean=m, half=0.1234, half_raters=None, count=9) for q, m in zip(QUESTIONS, means, strict=True)}
    return ResultRow(system=system, group=group, category=category, scores=scores)


def test_the_papers_form():
    rows = [
        row("EDGE", "Comparison with SOTA", "dance", 0.148, -0.136, 0.099),
        row("Ours", "Comparison with SOTA", "dance", 0.244, 0.337, 0.267),
        row("Ours", "Comparison with SOTA", "gesture", 0.588, 0.798, 0.816),
    ]
    text = latex_table(rows, QUESTIONS, caption="A study")
    lines = text.splitlines()
    assert r"\begin{tabular}{ll ccc c ccc}" in lines
    assert r"\multicolumn{3}{c}{Dance} & & \multicolumn{3}{c}{Gesture} \\" in text
    assert r"\cmidrule(lr){3-5} \cmidrule(lr){7-9}" in lines
    first = r"\multirow{2}{*}{Comparison with SOTA} & EDGE & $0.148 \pm 0.123$ & $-0.136 \pm 0.123$"
    assert first + r" & $0.099 \pm 0.123$ & & - & - & - \\" in lines
    assert lines.count(r"\midrule") == 1
    assert text.count("&") == 4 + 3 * 8  # nine columns; in the first row a title spans three


def test_names_cannot_break_the_table():
    assert escaped("50% & more_\n{x}") == r"50\% \& more\_ \{x\}"
    assert escaped("\\input{x}") == r"\textbackslash{}input\{x\}"


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex; apt install texlive-latex-extra")
def test_latex_takes_the_table(tmp_path):
    rows = [row("Ours & _theirs_", "50% {more}", "dance", 0.148, -0.136, 0.099)]
    table = latex_table(rows, QUESTIONS, caption="~ ^ \\ #1 $")
    packages = table.splitlines()[0].removeprefix("% ")
    page = rf"\documentclass{{article}}{packages}\begin{{document}}{table}\end{{document}}"
    (tmp_path / "page.tex").write_text(page)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=120)
    assert (tmp_path / "page.pdf").stat().st_size > 10_000
