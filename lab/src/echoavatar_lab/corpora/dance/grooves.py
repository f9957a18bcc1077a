"""Whole-body movement of each musical style, and the counts that a dancer hears in a music span."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from echoavatar.timing import FRAME_RATE_HZ

from ..sound import Section, SoundTrack, Span

HALF_TIME_BPM = 150.0  # above it, one count is two beats (not in 3/4)


@dataclass(frozen=True)
class Groove:
    """The constant movement of a style, below figures and moves."""

    name: str
    bounce: float  # metres the pelvis travels per count
    is_up: bool = False  # the body is high on the beat instead of low
    sharp: float = 1.4  # above 1: short down, long up
    hips: float = 0.07  # radians of pelvis roll with the weight
    nod: float = 0.06  # radians of head per count
    chest: float = 0.03  # radians of chest per count
    crouch: float = 0.022  # metres below standing
    lean: float = 0.03  # radians forward


GROOVES = {
    groove.name: groove
    for groove in (
        Groove("house", 0.052, crouch=0.028, nod=0.08, hips=0.10),
        Groove("hip_hop", 0.066, sharp=1.9, crouch=0.045, nod=0.12, chest=0.06, lean=0.07, hips=0.10),
        Groove("drum_and_bass", 0.058, sharp=1.6, crouch=0.035, nod=0.09, lean=0.05, hips=0.09),
        Groove("rock", 0.048, nod=0.11, lean=0.04, hips=0.08),
        Groove("swing", 0.042, is_up=True, crouch=0.030, nod=0.05, hips=0.09),
        Groove("salsa", 0.024, hips=0.15, nod=0.03, chest=0.02),
        Groove("waltz", 0.034, is_up=True, sharp=1.0, hips=0.05, nod=0.02, chest=0.01, lean=0.0),
        Groove("ballet", 0.024, is_up=True, sharp=1.0, hips=0.04, nod=0.02, chest=0.015, crouch=0.014, lean=0.0),
        Groove("ballad", 0.028, sharp=1.0, hips=0.09, nod=0.04, chest=0.02),
        Groove("pop", 0.046, hips=0.10),
        Groove("rest", 0.010, sharp=1.0, hips=0.05, nod=0.02, chest=0.01, crouch=0.006, lean=0.0),
    )
}


@dataclass(frozen=True)
class Counts:
    """A music span as a dancer counts it: times of the counts, metre, style and sections by count."""

    times: NDArray[np.float64]
    metre: int
    groove: Groove
    sections: tuple[tuple[int, int, float], ...]  # first count, end count, energy
    start: float
    end: float
    unit: int = 1  # beats in a count

    def at(self, count: float) -> float:
        """Time of a whole or fractional count; the tempo continues beyond the ends."""
        last = len(self.times) - 1
        if count <= 0:
            return float(self.times[0] + count * self.length(0))
        if count >= last:
            return float(self.times[last] + (count - last) * self.length(last - 1))
        return float(np.interp(count, np.arange(last + 1), self.times))

    def beat(self, number: float) -> float:
        """Time of a beat by its number; 0 is the first count, and beats go on beyond the ends."""
        return self.at(number / self.unit)

    def length(self, count: int) -> float:
        """Seconds from a count to the next one."""
        at = min(max(count, 0), len(self.times) - 2)
        return float(self.times[at + 1] - self.times[at])

    def energy(self, count: int) -> float:
        """Energy of the section that a count lies in."""
        return next((energy for first, end, energy in self.sections if first <= count < end), 0.5)

    def apart(self, seconds: float, counts: int) -> int:
        """The least multiple of so many counts that lasts some seconds."""
        return counts * max(1, int(np.ceil(seconds / (counts * self.length(0)))))

    def frames(self, after_s: float, most: int) -> tuple[int, int]:
        """First frame and end of the span and some seconds after it, in a dance of `most` frames."""
        first, end = (int(np.clip(round(t * FRAME_RATE_HZ), 0, most)) for t in (self.start, self.end + after_s))
        return first, end


def find_counts(track: SoundTrack, span: Span) -> Counts:
    """The counts of a music span; if it has no beats, slow counts to sway to."""
    beats = np.asarray(track.beats, np.float64)
    beats = beats[(beats >= span.start - 0.02) & (beats < span.end)]
    if len(beats) < 5:
        times = np.arange(span.start + 0.6, max(span.end, span.start + 2.0), 1.2)
        times = times if len(times) > 1 else np.array([span.start + 0.6, span.start + 1.8])
        return Counts(times, 4, GROOVES["rest"], ((0, len(times), 0.2),), span.start, span.end)
    bpm = 60.0 / float(np.median(np.diff(beats)))
    downs = np.searchsorted(beats, np.asarray(track.downbeats) - 0.03)
    downs = np.unique(downs[downs < len(beats)])
    beats_per_bar = int(np.median(np.diff(downs))) if len(downs) > 2 else 4
    metre = 3 if beats_per_bar == 3 else 4
    unit = 2 if metre == 4 and bpm > HALF_TIME_BPM else 1
    first = int(downs[0]) % (unit if unit > 1 else beats_per_bar) if len(downs) else 0
    times = beats[first::unit]
    groove = GROOVES[_style(track, bpm, beats_per_bar)]
    return Counts(times, metre, groove, _sections(track, times, span), span.start, span.end, unit)


def _style(track: SoundTrack, bpm: float, beats_per_bar: int) -> str:
    """The track's style if its tempo fits this span, otherwise one that tempo and metre suggest."""
    if beats_per_bar == 3:
        return "waltz"
    is_labelled = track.bpm > 0 and abs(bpm / track.bpm - 1) < 0.08
    if is_labelled and track.style in GROOVES:
        return track.style
    if is_labelled and track.style in ("march", "solo"):
        return "ballad" if bpm < 90 else "pop"
    if beats_per_bar == 2 or bpm < 62:
        return "ballet"
    for limit, style in ((80, "ballad"), (100, "hip_hop"), (117, "pop"), (131, "house"), (152, "rock")):
        if bpm < limit:
            return style
    return "drum_and_bass" if 163 <= bpm <= 178 else "salsa"


def _sections(track: SoundTrack, times: NDArray[np.float64], span: Span) -> tuple[tuple[int, int, float], ...]:
    """Sections of the span as consecutive ranges of counts."""
    inside = [s for s in track.sections if s.start < span.end - 0.2 and s.end > span.start + 0.2]
    inside = sorted(inside, key=lambda s: s.start) or [Section(span.start, span.end, 0.55)]
    firsts = [int(np.searchsorted(times, s.start - 0.1)) for s in inside]
    firsts[0] = 0
    ends = [*firsts[1:], len(times)]
    rows = zip(firsts, ends, inside, strict=True)
    return tuple((a, b, float(np.clip(s.energy, 0.0, 1.0))) for a, b, s in rows if b > a)
