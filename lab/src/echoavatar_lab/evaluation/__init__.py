"""Evaluates bundles: reconstruction, audio reliance, behaviour, alignment with audio, latency.

May import `engine` and below.
"""
