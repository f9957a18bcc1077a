"""Speech with exact labels: scripts, voices, prosody, lips, singing. May import `music`, `sound` and `echoavatar`."""
