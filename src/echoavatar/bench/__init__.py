"""Measures the avatar on this machine: time to start, stages of a chunk, the face, many sessions.

May import `engine`, `server` and below.
"""
