"""EchoAvatar: an audio stream becomes full-body motion, in real time."""

__version__ = "0.1.0"
