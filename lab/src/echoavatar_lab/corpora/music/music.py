"""Music composed by rule, with known beats: style, tempo, sections of given energy, chords, bass, melody, drums.

One voice marks each beat and the metre is accented, so that the beat can be heard. Some pieces have no drums, some are
solos, some have a sung lead. Not in the paper.
"""

from dataclasses import dataclass, field

import numpy as np

from ..sound import Note, Piece, Section, TimeArray
from .styles import STYLES, Style

_MAJOR, _MINOR = (0, 2, 4, 5, 7, 9, 11), (0, 2, 3, 5, 7, 8, 10)
_PROGRESSIONS = ((0, 4, 5, 3), (0, 5, 3, 4), (0, 3, 4, 0), (5, 3, 0, 4), (0, 5, 1, 4), (3, 4, 2, 5), (0, 2, 3, 4))
_FORMS = (
    (("intro", 0.35), ("a", 0.6), ("b", 0.95), ("break", 0.25), ("a", 0.65), ("b", 1.0)),
    (("a", 0.5), ("b", 0.85), ("a", 0.6), ("bridge", 0.45), ("b", 0.95)),
    (("b", 0.9), ("a", 0.55), ("break", 0.2), ("b", 1.0)),
    (("a", 0.7), ("a", 0.75), ("b", 0.9), ("bridge", 0.5), ("b", 0.9)),
)
_DRUM_ENERGY = {"kick": 0.3, "snare": 0.4, "clap": 0.4, "hat": 0.35, "ride": 0.3}


@dataclass(frozen=True)
class Band:
    """Instruments and key of a piece."""

    lead: str
    comp: str
    bass: str
    root: int
    scale: tuple[int, ...]
    progression: tuple[int, ...]
    has_drums: bool
    is_solo: bool
    has_lead: bool

    def degree(self, step: int) -> int:
        """Pitch of a scale step above the root."""
        octave, place = divmod(step, 7)
        return self.root + 12 * octave + self.scale[place]


@dataclass
class _Grid:
    """Beat times with tempo drift, and the notes written so far."""

    style: Style
    beats: TimeArray
    rng: np.random.Generator
    notes: list[Note] = field(default_factory=list)

    @property
    def bars(self) -> int:
        return (len(self.beats) - 1) // self.style.beats_per_bar

    def time(self, bar: int, step: int) -> float:
        beat, part = divmod(step, self.style.steps_per_beat)
        fraction = part / self.style.steps_per_beat
        if self.style.swing and part % 2:
            fraction += self.style.swing / self.style.steps_per_beat
        elif self.style.swing > 0.3 and part == 2:
            fraction += self.style.swing / 2
        index = bar * self.style.beats_per_bar + beat
        return float(self.beats[index] + fraction * (self.beats[index + 1] - self.beats[index]))

    def accent(self, step: int) -> float:
        """Change of velocity for the start of a bar, for other beats, and for steps between beats."""
        return 0.2 if step == 0 else 0.1 if step % self.style.steps_per_beat == 0 else -0.12

    def add(self, bar: int, step: int, steps: float, pitch: int, velocity: float, instrument: str) -> None:
        """Add one note at a step of a bar, with a random timing error (4 ms) like a player's."""
        start = self.time(bar, step)
        step_s = (self.time(bar + 1, 0) - self.time(bar, 0)) / self.style.steps
        start = max(0.0, start + float(self.rng.normal(0, 0.004)))
        loudness = float(np.clip(velocity + self.rng.normal(0, 0.03), 0.08, 1.0))
        self.notes.append(Note(start, max(0.06, steps * step_s), pitch, loudness, instrument))


def compose_piece(rng: np.random.Generator, seconds: float, style: str = "") -> Piece:
    """Compose about `seconds` of music: whole bars and a final chord, or cut at any point."""
    kind = STYLES[style] if style else list(STYLES.values())[rng.integers(len(STYLES))]
    bpm = float(rng.uniform(*kind.bpm))
    is_cut = bool(rng.random() < 0.5)
    grid = _Grid(kind, _beat_times(rng, kind, bpm, seconds), rng)
    band = _draw_band(rng, kind)
    last_bar = grid.bars - 3
    plan = _plan_sections(rng, last_bar)
    motifs = {name: _draw_motif(rng, kind) for name, *_ in plan}
    for name, energy, first, count in plan:
        for bar in range(first, first + count):
            _play_bar(grid, band, bar, energy, name, motifs[name], is_last=bar == first + count - 1)
    end = float(grid.beats[last_bar * kind.beats_per_bar])
    if is_cut:
        end = float(min(end, seconds * rng.uniform(0.9, 1.0)))
    else:
        _final_chord(grid, band, last_bar)
    return _as_piece(grid, plan, bpm, end, is_cut=is_cut)


def _beat_times(rng: np.random.Generator, style: Style, bpm: float, seconds: float) -> TimeArray:
    """Beat times of whole bars, three bars more than needed; the tempo drifts slowly in a third of the pieces."""
    bar_s = style.beats_per_bar * 60 / bpm
    count = (max(2, round(seconds / bar_s)) + 3) * style.beats_per_bar + 1
    drift = np.cumsum(rng.normal(0, 0.004, count)) if rng.random() < 0.35 else np.zeros(count)
    lengths = 60 / bpm * np.exp(np.clip(drift, -0.06, 0.06))
    return np.concatenate([[0.0], np.cumsum(lengths)])[:count]


def _draw_band(rng: np.random.Generator, style: Style) -> Band:
    is_solo = style.name == "solo"
    return Band(
        lead=style.leads[rng.integers(len(style.leads))],
        comp=style.comps[rng.integers(len(style.comps))],
        bass=style.basses[rng.integers(len(style.basses))],
        root=int(rng.integers(45, 57)),
        scale=_MAJOR if rng.random() < 0.55 else _MINOR,
        progression=_PROGRESSIONS[rng.integers(len(_PROGRESSIONS))],
        has_drums=bool(style.drums) and rng.random() < 0.8,
        is_solo=is_solo and rng.random() < 0.6,
        has_lead=is_solo or rng.random() < 0.8,
    )


def _plan_sections(rng: np.random.Generator, bars: int) -> list[tuple[str, float, int, int]]:
    """Sections as (name, energy, first bar, bars) that fill `bars`."""
    form = _FORMS[rng.integers(len(_FORMS))]
    length = 4 if bars < 28 else 8
    plan: list[tuple[str, float, int, int]] = []
    first = 0
    while first < bars:
        name, energy = form[len(plan) % len(form)]
        count = min(length // 2 if name == "break" else length, bars - first)
        plan.append((name, float(np.clip(energy + rng.normal(0, 0.05), 0.15, 1)), first, count))
        first += count
    return plan


def _draw_motif(rng: np.random.Generator, style: Style) -> tuple[tuple[int, int, int], ...]:
    """A two-bar melody as (step, length in steps, scale step), mostly on beats."""
    steps = 2 * style.steps
    weight = np.array([5.0 if s % style.steps_per_beat == 0 else 2.0 if s % 2 == 0 else 0.6 for s in range(steps)])
    count = max(3, int(style.melody_density * steps / 3))
    places = np.sort(rng.choice(steps, size=min(count, steps), replace=False, p=weight / weight.sum()))
    ends = np.append(places[1:], steps)
    height, motif = int(rng.integers(5, 10)), []
    for place, end in zip(places.tolist(), ends.tolist(), strict=True):
        motif.append((place, max(1, min(end - place, 8)), height))
        height = int(np.clip(height + rng.choice([-2, -1, -1, 0, 1, 1, 2, 3]), 2, 13))
    return tuple(motif)


def _play_bar(
    grid: _Grid,
    band: Band,
    bar: int,
    energy: float,
    section: str,
    motif: tuple[tuple[int, int, int], ...],
    *,
    is_last: bool,
) -> None:
    """Add one bar of every part that plays at this energy."""
    style = grid.style
    chord = band.progression[bar % len(band.progression)]
    loud = 0.35 + 0.5 * energy
    is_break = section == "break"
    if band.has_drums and not is_break:
        _play_drums(grid, bar, energy, loud, has_fill=is_last)
    if not is_break and not band.is_solo:
        for step, level in _hits(style.bass):
            walk = chord + (0, 2, 4, 5)[step // style.steps_per_beat % 4] if style.name == "swing" else chord
            pitch = band.degree(walk) - 12 - (12 if band.root > 51 else 0)
            grid.add(bar, step, 2.5, pitch, loud * level + grid.accent(step), band.bass)
    if not band.is_solo:
        _play_chords(grid, band, bar, chord, loud)
    if band.has_lead and (energy > 0.42 or band.is_solo or not band.has_drums):
        half = style.steps * (bar % 2)
        for step, length, height in motif:
            if half <= step < half + style.steps and grid.rng.random() < 0.88:
                pitch = band.degree(height + chord % 3) + (12 if band.root < 50 else 0)
                grid.add(bar, step - half, length * 0.95, pitch, loud + grid.accent(step - half), band.lead)
    if band.is_solo or not band.has_drums:  # without drums, this voice marks the beats
        for beat in range(style.beats_per_bar):
            pitch = band.degree(chord + (0 if beat == 0 else 4)) - (12 if beat == 0 else 0)
            step = beat * style.steps_per_beat
            voice = band.lead if band.is_solo and band.lead not in _SUNG else band.comp
            grid.add(bar, step, style.steps_per_beat * 0.9, pitch, loud + grid.accent(step), voice)


_SUNG = ("voice_aah", "voice_ooh", "flute", "clarinet", "trumpet")


def _play_drums(grid: _Grid, bar: int, energy: float, loud: float, *, has_fill: bool) -> None:
    style = grid.style
    for row, (drum, pattern) in enumerate(style.drums):
        if row and energy < _DRUM_ENERGY.get(drum, 0.5):
            continue
        for step, level in _hits(pattern):
            if has_fill and step >= style.steps // 2 and drum not in ("ride", "bell_bar", "kick"):
                continue
            grid.add(bar, step, 1, 0, loud * level + grid.accent(step), drum)
    if has_fill and energy > 0.45:
        for step in range(style.steps // 2, style.steps):
            if grid.rng.random() < 0.7:
                drum = ("snare", "tom_high", "tom_low")[min(2, 6 * (step - style.steps // 2) // style.steps)]
                grid.add(bar, step, 1, 0, loud + grid.accent(step), drum)
        grid.add(bar + 1, 0, 4, 0, loud, "crash")


def _play_chords(grid: _Grid, band: Band, bar: int, chord: int, loud: float) -> None:
    hits = _hits(grid.style.chords)
    for i, (step, level) in enumerate(hits):
        following = hits[i + 1][0] if i + 1 < len(hits) else grid.style.steps
        for voice in (0, 2, 4):
            pitch = band.degree(chord + voice)
            pitch -= 12 if pitch > band.root + 13 else 0
            velocity = 0.75 * loud * level + grid.accent(step)
            grid.add(bar, step, (following - step) * 0.9, pitch, velocity, band.comp)


def _hits(pattern: str) -> list[tuple[int, float]]:
    return [(step, 1.0 if mark == "x" else 0.55) for step, mark in enumerate(pattern) if mark != "-"]


def _final_chord(grid: _Grid, band: Band, bar: int) -> None:
    """Hold the tonic chord for a bar on the last downbeat."""
    start = grid.time(bar, 0)
    hold = min(2.5, 1.2 * (grid.time(bar + 1, 0) - start))
    for voice in (-7, 0, 2, 4, 7):
        grid.notes.append(Note(start, hold, band.degree(voice), 0.85, band.comp))
    if band.has_drums:
        grid.notes += [Note(start, 1.0, 0, 0.9, "kick"), Note(start, 1.0, 0, 0.8, "crash")]


def _as_piece(grid: _Grid, plan: list[tuple[str, float, int, int]], bpm: float, end: float, *, is_cut: bool) -> Piece:
    beats = grid.beats[grid.beats <= end + (1e-6 if not is_cut else -1e-6)]
    downbeats = beats[:: grid.style.beats_per_bar]
    limit = end if is_cut else end + 0.05
    sections = [Section(grid.time(f, 0), min(grid.time(f + n, 0), end), e) for _, e, f, n in plan]
    return Piece(
        notes=tuple(sorted((n for n in grid.notes if n.start < limit), key=lambda note: note.start)),
        beats=beats,
        downbeats=downbeats,
        sections=tuple(s for s in sections if s.end > s.start),
        style=grid.style.name,
        bpm=bpm,
        seconds=end if is_cut else end + 2.5,
        is_cut=is_cut,
    )
