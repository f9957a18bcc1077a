"""Rehearsal: a synthetic corpus of sound and motion, so that training needs no third-party recordings.

`track` makes text, voices, music and their labels; `choreography` moves to them, `solver` turns the result into joint
rotations, `corpus` writes clips. May import `models`, every other room of `corpora`, and below. Everything follows from
its seed.
"""
