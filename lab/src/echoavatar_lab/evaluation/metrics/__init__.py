"""The metrics of the research bench, one concept a file: pure functions of arrays. Docstrings give formula, unit and
variants; `docs/metrics.md` is the guide.

May import `kinematics`, `nn` and below; `evaluation` and training rooms use it.
"""
