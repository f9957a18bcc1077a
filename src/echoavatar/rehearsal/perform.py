"""A whole performance of a sound track: speech, music and silence joined by human transitions."""

from .controls import Controls
from .gesture import gesture
from .sound import SoundTrack


def perform(track: SoundTrack, seed: int) -> Controls:
    """Move to a track; the same track and seed give the same motion."""
    return gesture(track, seed)
