"""Speakers: how different people gesture, as a few numbers, and how a voice raises or calms it.

A manner is drawn for each performance and kept with it, so that a model can be told whom it is to move like. Sizes and
rates reach the range of captured speakers (`evaluation.captured_people`). Not in the paper, which trains on recorded
speakers.
"""

from dataclasses import dataclass

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ

from ..sound import SoundTrack


@dataclass(frozen=True)
class Manner:
    """How one person gestures; every value is between 0 and 1, and 0.5 is nothing special.

    Attributes:
        liveliness: 0 is few, small and slow gestures on a quiet body; 1 is a storyteller.
        right: which hand leads; the chance that a gesture of one hand is the right hand's.
        both: chance that both hands work in a phrase; otherwise one works, or they take turns.
        mirror: how much two working hands share; 0: each its own way, size and time, 1: nearly mirror images.
        space: where gestures are; 0 is low, narrow and near the body, 1 high and wide.
        hold: 0: hands keep moving, and sink at once after a phrase; 1: they stay up, with small moves.
        bow: how far the trunk bends forwards as the hands sink; upright at 0.
        tilt: how far the shoulder of a raised hand rises; level at 0.
        rest: where idle hands are: below 0.55 at the sides, then clasped (0.75), on the hip (0.9), behind the back.
    """

    liveliness: float = 0.5
    right: float = 0.7
    both: float = 0.5
    mirror: float = 0.25
    space: float = 0.5
    hold: float = 0.5
    bow: float = 0.5
    tilt: float = 0.5
    rest: float = 0.0

    @property
    def energy(self) -> float:
        """Size of gestures; 1 is a person in conversation."""
        return 0.5 + 1.1 * self.liveliness

    @property
    def pace(self) -> float:
        """How many syllables get a gesture; 1 is a person in conversation."""
        return 0.9 + 0.4 * self.liveliness

    @property
    def resting(self) -> str:
        """Where idle hands are: "sides", "clasped", "hips" or "behind"."""
        return ("sides", "clasped", "hips", "behind")[int(np.searchsorted((0.55, 0.75, 0.9), self.rest, "right"))]


def draw_manner(seed: int) -> Manner:
    """The manner that follows from a performance's seed; four people in five lead with the right hand."""
    rng = np.random.default_rng([seed, 1])
    right = float(rng.beta(4, 2))
    return Manner(
        liveliness=float(rng.beta(2, 2)),
        right=1 - right if rng.random() < 0.1 else right,
        both=float(rng.beta(2, 2)),
        mirror=float(rng.beta(1.2, 4)),
        space=float(rng.beta(2, 2)),
        hold=float(rng.beta(2, 2)),
        bow=float(rng.random()),
        tilt=float(rng.random()),
        rest=float(rng.random()),
    )


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
