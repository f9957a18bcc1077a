"""The metrics: pure functions of arrays. Docstrings give formula, unit and variants; `docs/metrics.md` is the guide.

May import `motion.kinematics`, `nn` and below; `evaluation` and training rooms use it.
"""
