"""Speakers: what a manner makes of gestures, and how a voice raises or calms them.

A manner is drawn for each performance and kept with it: the generator is told it (`models/generator/manner.py`).
Sizes and rates reach the range of captured speakers. Not in the paper, which trains on recorded speakers.
"""

import numpy as np

from echoavatar.models.generator.manner import Manner
from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import SoundTrack


def energy_of(manner: Manner) -> float:
    """Size of gestures; 1 is a person in conversation."""
    return 0.5 + 1.1 * manner.liveliness


def pace_of(manner: Manner) -> float:
    """How many syllables get a gesture; 1 is a person in conversation."""
    return 0.9 + 0.4 * manner.liveliness


def resting_of(manner: Manner) -> str:
    """Where idle hands are: "sides", "clasped", "hips" or "behind"."""
    return ("sides", "clasped", "hips", "behind")[int(np.searchsorted((0.55, 0.75, 0.9), manner.rest, "right"))]


def arousal(track: SoundTrack, phrase: tuple[float, float]) -> float:
    """How excited a phrase sounds, about 0.7 (slow, even, dull) to 1.35: it scales the size and rate of gestures.

    What counts is what is heard whatever the recording's level: syllables a second, the range of loudness between
    them, and the share of high frequencies.
    """
    begin, end = phrase
    inside = [s for s in track.syllables if begin - 0.02 <= s.vowel < end]
    audio = track.audio[round(begin * SAMPLE_RATE_HZ) : round(end * SAMPLE_RATE_HZ)].astype(np.float64)
    if len(inside) < 3 or len(audio) < SAMPLE_RATE_HZ // 2:
        return 1.0
    rate = len(inside) / (end - begin)
    blocks = audio[: len(audio) // 600 * 600].reshape(-1, 600)
    level = 10 * np.log10((blocks**2).mean(1) + 1e-9)
    voiced = level > level.max() - 30
    change = np.diff(blocks, axis=1)
    bright = float(np.log((change[voiced] ** 2).sum() / max((blocks[voiced] ** 2).sum(), 1e-9) + 1e-6))
    excited = 0.12 * (rate - 4.5) + 0.02 * (float(level[voiced].std()) - 6.5) + 0.10 * (bright + 3.2)
    return float(np.clip(1.0 + excited, 0.7, 1.35))
