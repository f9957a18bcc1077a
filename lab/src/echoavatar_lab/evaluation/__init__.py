"""Evaluates bundles: reconstruction, audio reliance, behaviour, alignment with audio, latency.

May import `corpora` and below.
"""
