"""The metrics: pure functions of arrays. Docstrings give formula, unit and variants; `docs/metrics.md` is the guide.

May import `data`, `training`, `checkpoint`, `kinematics` and `echoavatar`; `evaluation` and training rooms use it.
"""
