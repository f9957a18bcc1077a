"""Speech with exact labels: scripts, voices, prosody, lips, singing. May import `corpora.music`, `sound` and below."""
