"""A score with true times: what the composer writes and the instruments play."""

from dataclasses import dataclass

from .sound import Section, TimeArray


@dataclass(frozen=True)
class Note:
    """One note: seconds, pitch (MIDI number; 0 for drums), velocity 0..1, and what plays it."""

    start: float
    duration: float
    pitch: int
    velocity: float
    instrument: str


@dataclass(frozen=True)
class Piece:
    """A score with its true times."""

    notes: tuple[Note, ...]
    beats: TimeArray
    downbeats: TimeArray
    sections: tuple[Section, ...]
    style: str
    bpm: float
    seconds: float  # where the music stops, tails apart
    is_cut: bool  # stops dead instead of on a final chord
