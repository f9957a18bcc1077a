"""Clips of sound and motion, and the folders that hold them. May import `progress` and `echoavatar`."""

from .clip import DOMAINS, MUSIC, SILENCE, SPEECH, Clip
from .corpus import ClipEntry, Corpus, Manifest, save_manifest, write_manifest
from .sounds import Sound, SoundSet

__all__ = [
    "DOMAINS",
    "MUSIC",
    "SILENCE",
    "SPEECH",
    "Clip",
    "ClipEntry",
    "Corpus",
    "Manifest",
    "Sound",
    "SoundSet",
    "save_manifest",
    "write_manifest",
]
