"""The research bench's metrics, one concept a file: pure functions of arrays. Formula, unit and variants stand in
each docstring; `docs/metrics.md` is the guide to them.

May import `kinematics`, `nn` and below; `evaluation` and training rooms use it.
"""
