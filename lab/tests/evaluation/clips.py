"""Clips that sway, with clicks for sound."""

from pathlib import Path

import numpy as np
from tests.motion.kinematics.samples import swaying

from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar_lab.data import Clip, write_manifest
from echoavatar_lab.data.corpus import clip_path

SPEECH, MUSIC = 1, 2


def clicks(frames: int, every_s: float, seed: int = 0) -> np.ndarray:
    """Short tones on a floor of noise, 24 kHz."""
    random = np.random.default_rng(seed)
    audio = random.normal(0, 1e-3, frames * SAMPLES_PER_FRAME)
    t = np.arange(1500) / 24_000
    tone = 0.5 * np.sin(2 * np.pi * 700 * t) * np.exp(-t * 60)
    for start in np.arange(0.3, frames / 30 - 0.1, every_s):
        at = int(start * 24_000)
        audio[at : at + len(tone)] += tone
    return audio.astype(np.float32)


def clip(
    name: str, frames: int = 240, *, size: float = 0.3, every_s: float = 0.5, kind: int = SPEECH, split: str = "test"
) -> Clip:
    motion = swaying(frames, size=size)
    domain = np.full(frames, kind, np.uint8)
    audio = clicks(frames, every_s)
    return Clip(name, audio, motion.rotations, motion.root, domain, split=split)


def folder(place: Path, clips: list[Clip], *, is_corpus: bool = False) -> Path:
    """A folder of these clips; with a manifest it is a corpus."""
    for one in clips:
        one.save(clip_path(place, one.name) if is_corpus else place / f"{one.name}.npz")
    if is_corpus:
        write_manifest(place)
    return place
