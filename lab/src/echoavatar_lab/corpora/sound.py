"""Sound tracks with their labels, which the choreography reads, and musical scores.

All times are seconds on the 24 kHz sample clock. Audio is mono float32 and always a whole number of motion frames
(800 samples) long. Not in the paper, which trains on recorded corpora.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

FloatArray = np.ndarray
TimeArray = np.ndarray
_STRETCHES = ("spans", "sections", "sources")

STRESSED = 0.45  # least prominence of a stressed syllable


@dataclass(frozen=True)
class Syllable:
    """One spoken syllable; `vowel` is the centre of its vowel, `prominence` 0..1 (from 0.85 on it is nuclear)."""

    start: float
    end: float
    vowel: float
    prominence: float
    word: str
    meaning: str  # "" or size, deixis, negation, count, contrast, question, greeting


@dataclass(frozen=True)
class Section:
    """A stretch of music of constant energy, 0..1."""

    start: float
    end: float
    energy: float


@dataclass(frozen=True)
class Span:
    """The louder sound in a stretch of time: kind is "silence", "speech" or "music"."""

    start: float
    end: float
    kind: str


@dataclass(frozen=True)
class Source:
    """The voice or the piece in a stretch: kind is "speech", "music" or "singing"; `name` and `style` describe it."""

    start: float
    end: float
    kind: str
    name: str  # of the voice, the players or the file
    style: str


@dataclass(frozen=True)
class SoundTrack:
    """Audio (s,) with all its labels."""

    audio: FloatArray
    spans: tuple[Span, ...] = ()
    syllables: tuple[Syllable, ...] = ()
    phrases: tuple[tuple[float, float], ...] = ()
    phones: tuple[tuple[float, float, str], ...] = ()
    beats: TimeArray = field(default_factory=lambda: np.zeros(0))
    downbeats: TimeArray = field(default_factory=lambda: np.zeros(0))
    sections: tuple[Section, ...] = ()
    style: str = ""
    bpm: float = 0.0
    sources: tuple[Source, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the audio."""
        return len(self.audio) / SAMPLE_RATE_HZ

    @property
    def stresses(self) -> list[float]:
        """Times of the vowels of stressed syllables, seconds."""
        return [syllable.vowel for syllable in self.syllables if syllable.prominence >= STRESSED]


@dataclass(frozen=True)
class Note:
    """One note: seconds, pitch (MIDI number; 0 for drums), velocity 0..1, and its instrument."""

    start: float
    duration: float
    pitch: int
    velocity: float
    instrument: str


@dataclass(frozen=True)
class Piece:
    """A score with its true times in seconds."""

    notes: tuple[Note, ...]
    beats: TimeArray
    downbeats: TimeArray
    sections: tuple[Section, ...]
    style: str
    bpm: float
    seconds: float  # where the music stops, without decaying tails
    is_cut: bool  # stops abruptly instead of on a final chord


def whole_frames(audio: FloatArray) -> FloatArray:
    """Pad with zeros at the end to a whole number of motion frames, as float32."""
    missing = -len(audio) % SAMPLES_PER_FRAME
    return np.concatenate([audio, np.zeros(missing)]).astype(np.float32)


def shift(track: SoundTrack, seconds: float, scale: float = 1.0) -> SoundTrack:
    """Multiply the times of all labels by `scale`, then move them later by `seconds`; the audio stays as it is."""

    def at(time: float) -> float:
        return time * scale + seconds

    stretches: dict[str, Any] = {
        name: tuple(replace(s, start=at(s.start), end=at(s.end)) for s in getattr(track, name)) for name in _STRETCHES
    }
    return replace(
        track,
        syllables=tuple(replace(s, start=at(s.start), end=at(s.end), vowel=at(s.vowel)) for s in track.syllables),
        phrases=tuple((at(a), at(b)) for a, b in track.phrases),
        phones=tuple((at(a), at(b), name) for a, b, name in track.phones),
        beats=track.beats * scale + seconds,
        downbeats=track.downbeats * scale + seconds,
        bpm=track.bpm / scale,
        **stretches,
    )


def concatenate(tracks: Sequence[SoundTrack]) -> SoundTrack:
    """Join tracks one after another; adjacent spans of one kind merge, style and bpm are those of the longest music."""
    if not tracks:
        return SoundTrack(np.zeros(0, np.float32))
    starts = np.cumsum([0] + [len(track.audio) for track in tracks[:-1]]) / SAMPLE_RATE_HZ
    moved = [shift(track, float(start)) for track, start in zip(tracks, starts, strict=True)]
    longest = max(tracks, key=lambda track: len(track.audio) if track.style else -1)
    return SoundTrack(
        audio=np.concatenate([track.audio for track in tracks]).astype(np.float32),
        spans=merge_spans([span for track in moved for span in track.spans]),
        beats=np.concatenate([track.beats for track in moved]),
        downbeats=np.concatenate([track.downbeats for track in moved]),
        style=longest.style,
        bpm=longest.bpm,
        **{
            name: tuple(label for track in moved for label in getattr(track, name))
            for name in ("syllables", "phrases", "phones", "sections", "sources")
        },
    )


def bridged(stretches: Iterable[tuple[float, float]], gap: float) -> list[tuple[float, float]]:
    """Stretches (start, end) in order of time, joined across gaps that are shorter than `gap` seconds."""
    joined: list[tuple[float, float]] = []
    for start, end in stretches:
        if joined and start - joined[-1][1] < gap:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((start, end))
    return joined


def merge_spans(spans: Sequence[Span]) -> tuple[Span, ...]:
    """Merge adjacent spans of the same kind and drop empty ones."""
    merged: list[Span] = []
    for span in spans:
        if span.end <= span.start:
            continue
        if merged and merged[-1].kind == span.kind:
            merged[-1] = replace(merged[-1], end=span.end)
        else:
            merged.append(span)
    return tuple(merged)


def cut(track: SoundTrack, seconds: float, start: float = 0.0) -> SoundTrack:
    """`seconds` of a track from `start` on, both rounded to whole frames; labels outside are dropped."""
    first = round(start * SAMPLE_RATE_HZ / SAMPLES_PER_FRAME) * SAMPLES_PER_FRAME
    frames = max(1, round(seconds * SAMPLE_RATE_HZ / SAMPLES_PER_FRAME))
    audio = track.audio[first : first + frames * SAMPLES_PER_FRAME]
    end = len(audio) / SAMPLE_RATE_HZ
    if first:
        track = shift(track, -first / SAMPLE_RATE_HZ)
    stretches: dict[str, Any] = {
        name: tuple(
            replace(s, start=max(s.start, 0.0), end=min(s.end, end))
            for s in getattr(track, name)
            if s.end > 0 and s.start < end
        )
        for name in _STRETCHES
    }
    return replace(
        track,
        audio=audio,
        syllables=tuple(s for s in track.syllables if s.start >= 0 and s.end <= end),
        phrases=tuple((max(a, 0.0), min(b, end)) for a, b in track.phrases if b > 0 and a < end),
        phones=tuple((max(a, 0.0), min(b, end), name) for a, b, name in track.phones if b > 0 and a < end),
        beats=track.beats[(track.beats >= 0) & (track.beats < end)],
        downbeats=track.downbeats[(track.downbeats >= 0) & (track.downbeats < end)],
        **stretches,
    )


def steadiest_path(
    strength: FloatArray, period: float, gaps: np.ndarray, tightness: float, last: int | None = None
) -> np.ndarray:
    """Frames, ascending, of the path with the largest sum of strengths, less what each gap is off the period.

    `gaps` are the steps that a path may take, ascending; it ends among the `last` frames (default: the longest gap).
    """
    cost = -tightness * np.log(gaps / period) ** 2
    total, back = strength.astype(np.float64), np.full(len(strength), -1)
    for frame in range(int(gaps[0]), len(strength)):
        before = frame - gaps[gaps <= frame]
        paths = total[before] + cost[: len(before)]
        best = int(np.argmax(paths))
        if paths[best] > 0:
            total[frame] += paths[best]
            back[frame] = before[best]
    end = max(0, len(total) - (int(gaps[-1]) if last is None else last))
    path = [end + int(np.argmax(total[end:]))]
    while back[path[-1]] >= 0:
        path.append(int(back[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)
