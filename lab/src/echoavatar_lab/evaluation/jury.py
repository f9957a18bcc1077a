"""`echoavatar evaluate BUNDLE jury`: what gives the body away? How it moves, beside people's range.

The statistics of `metrics.tells` are measured in windows of the avatar's free run, of a folder of takes or of a
corpus, and of captured people clip by clip. A row says by how many of people's half ranges ours lies outside their
range. The first rows are the tells. People's ranges rest on few clips, so a distance of up to `TOLERANCE` counts as
inside.
"""

import itertools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from echoavatar.errors import EchoAvatarError
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.data import DOMAINS
from echoavatar_lab.progress import Progress, watched

from .measures import stretches
from .metrics.liveliness import MUSIC, SPEECH, windows
from .metrics.tells import HEARD, TELLS, loudness, tells
from .motion_folder import sources
from .onlooker import Told
from .paid_for import LEGEND, PAID_FOR, marked
from .table import NAN, Interval, mean_interval, rounded, weighted_mean
from .takes import Take, points_of

TOLERANCE = 0.03  # half ranges
FEWEST_PEOPLE = 2  # clips that make a range
NAMES = (*TELLS, *HEARD)


class Verdict(NamedTuple):
    """One statistic: people's lowest, middle and highest clip, and ours."""

    name: str
    low: float
    median: float
    high: float
    ours: float
    interval: Interval  # 95 %, over clips
    outside: float  # half ranges; NaN without a range

    @property
    def is_outside(self) -> bool:
        """Whether ours counts as outside."""
        return self.outside > TOLERANCE


def read_moving(place: Path, most: int) -> list[Take]:
    """Stretches of speech and of music of the first clips of a corpus, or of the first takes of a folder.

    A take without labels is music if its name says "music" or "dance", else speech. Raises EchoAvatarError if a clip
    cannot be read, or no clip has 10 s of speech or music.
    """
    found = []
    for name, source in itertools.islice(sources(place, None).items(), most):
        read = source.read(is_resampling=True)
        if read.domain is None:
            kind = MUSIC if any(word in name.lower() for word in ("music", "dance")) else SPEECH
            found.append(Take(name, kind, "", read.motion, read.audio))
            continue
        for kind in (SPEECH, MUSIC):
            for part in stretches(read.domain, DOMAINS.index(kind)):
                own = read.motion.cut(part.start, part.stop)
                heard = slice(part.start * SAMPLES_PER_FRAME, part.stop * SAMPLES_PER_FRAME)
                found.append(Take(name, kind, "", own, None if read.audio is None else read.audio[heard]))
    if not found:
        raise EchoAvatarError(f"{place} has no 10 s of speech or music in its first {most} clips; raise --clips")
    return found


def verdicts(
    ours: Sequence[Take], people: Sequence[Take], seconds: float, *, progress: Progress | None = None
) -> dict[str, list[Verdict]]:
    """The rows of speech and of music, as far as ours has them, the furthest outside first.

    Ours are means over windows of `seconds` and performances, with intervals over clips (by name and class). Raises
    MotionError if a rig is not known, or a take is shorter than a second; names the take.
    """
    clips: dict[tuple[str, bool], dict[tuple[str, str], list[dict[str, float]]]]
    clips = {(kind, is_ours): defaultdict(list) for kind in (SPEECH, MUSIC) for is_ours in (True, False)}
    takes = [(take, is_ours) for side, is_ours in ((ours, True), (people, False)) for take in side]
    for take, is_ours in watched([one for one in takes if one[0].kind in (SPEECH, MUSIC)], progress):
        clips[take.kind, is_ours][take.name, take.group] += tells_of_windows(take, seconds)
    found = {}
    for kind in (SPEECH, MUSIC):
        own, theirs = (list(clips[kind, is_ours].values()) for is_ours in (True, False))
        if own:
            rows = [_verdict(name, own, theirs) for name in NAMES]
            found[kind] = sorted(rows, key=lambda row: -np.nan_to_num(row.outside, nan=-1))
    return found


def tells_of_windows(take: Take, seconds: float) -> list[dict[str, float]]:
    """The statistics of each window of a take."""
    points = points_of(take)
    parts = windows(points, FRAME_RATE_HZ, seconds)
    if take.audio is None:
        return [tells(part) for part in parts]
    loud = loudness(take.audio)[: len(points)]
    loud = np.pad(loud, (0, len(points) - len(loud)))
    return [tells(*pair) for pair in zip(parts, windows(loud, FRAME_RATE_HZ, seconds), strict=True)]


def _verdict(
    name: str, ours: Sequence[Sequence[Mapping[str, float]]], people: Sequence[Sequence[Mapping[str, float]]]
) -> Verdict:
    means, theirs = (
        np.array([weighted_mean(np.array([row.get(name, NAN) for row in clip])) for clip in side])
        for side in (ours, people)
    )
    weights = np.array([len(clip) for clip in ours], float)
    value, interval = weighted_mean(means, weights), mean_interval(means, weights)
    known = theirs[np.isfinite(theirs)]
    if len(known) < FEWEST_PEOPLE:
        return Verdict(name, NAN, weighted_mean(known), NAN, value, interval, NAN)
    low, median, high = np.quantile(known, (0, 0.5, 1)).tolist()
    outside = np.maximum(np.maximum(low - value, value - high), 0) / ((high - low) / 2 + 1e-9)
    return Verdict(name, low, median, high, value, interval, float(outside))


def as_text(found: Mapping[str, Sequence[Verdict]], told: Mapping[str, Mapping[str, Told]]) -> str:
    """A table for each kind of sound, and what the onlooker of each says."""
    lines = []
    for kind, rows in found.items():
        lines.append(f"{kind:<38}{'people low':>12}{'median':>9}{'high':>9}{'ours':>9}{'95 %':>18}{'outside':>9}")
        for row in rows:
            numbers = "".join(f"{_cell(value):>9}" for value in (row.median, row.high, row.ours))
            span = f"{_cell(row.interval.low)} to {_cell(row.interval.high)}"
            lines.append(f"{marked(row.name):<38}{_cell(row.low):>12}{numbers}{span:>18}{_cell(row.outside):>9}")
        lines.append(f"outside: {_count(rows)} of {sum(np.isfinite(row.outside) for row in rows)}")
        for name, (accuracy, ends) in told.get(kind, {}).items():
            lines.append(f"told apart by movement: {name} {_cell(accuracy)} ({_cell(ends.low)} to {_cell(ends.high)})")
    return "\n".join([*lines, LEGEND])


def as_json(
    found: Mapping[str, Sequence[Verdict]], told: Mapping[str, Mapping[str, Told]]
) -> dict[str, dict[str, object]]:
    """By kind of sound: how many rows lie outside, which most, all rows, and how ours is told; null: no value."""
    return {
        kind: {
            "outside": _count(rows),
            "of": sum(bool(np.isfinite(row.outside)) for row in rows),
            "tells": [row.name for row in rows if row.is_outside][:8],
            "rows": {row.name: _plain(row) | {"paid_for": row.name in PAID_FOR} for row in rows},
            "told_apart": {name: _plain(one) for name, one in told.get(kind, {}).items()},
        }
        for kind, rows in found.items()
    }


def _plain(row: Verdict | Told) -> dict[str, object]:
    """The numbers of a row by name."""
    numbers = {name: value for name, value in row._asdict().items() if name != "name"}
    return {name: [*map(rounded, x)] if isinstance(x, Interval) else rounded(x) for name, x in numbers.items()}


def _count(rows: Sequence[Verdict]) -> int:
    return sum(row.is_outside for row in rows)


def _cell(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"
