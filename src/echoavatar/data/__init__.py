"""Clips of sound and motion, and the folders that hold them. May import `kinematics` and below."""

from .clip import DOMAINS, Clip
from .corpus import ClipEntry, Corpus, write_manifest

__all__ = ["DOMAINS", "Clip", "ClipEntry", "Corpus", "write_manifest"]
