"""Sets to train on: published data prepared from the user's copy, and the synthetic rehearsal corpus.

May import `files` and below; nothing that runs live imports it.
"""
