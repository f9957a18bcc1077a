"""Measurements of a developer: stages without a model, long runs with faults, CUDA graphs, training steps.

May import `evaluation` and below.
"""
