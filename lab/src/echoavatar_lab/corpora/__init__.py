"""Sets to train on: a library of captured people, the synthetic rehearsal corpus, and faces.

May import `models` and below; nothing that runs live imports it.
"""
