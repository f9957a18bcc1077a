"""`echoavatar evaluate BUNDLE drift`: does the body still move in minute 10 as it did in minute 1?

Every sound is cut to one minute and repeated, so that each minute hears the same. The rows of `alive` and of the jury
are measured in two of these minutes. A difference is then of the avatar's own past (Rolling Diffusion and other models
of endless motion show such curves, each with rows of its own; no definition is published that all share). Differences
are paired by sound, and their intervals are over sounds.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from echoavatar.errors import EchoAvatarError
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.progress import Progress, watched

from .alive import Statistics, measure
from .jury import NAMES, tells_of_windows
from .paid_for import LEGEND, marked
from .table import LEVEL, NAN, UNKNOWN, Interval, rounded, weighted_mean
from .takes import Sound, Take

MINUTE_S = 60.0


class Drift(NamedTuple):
    """One row of a kind of sound: means over sounds of both minutes, and of the later less the earlier."""

    name: str
    earlier: float
    later: float
    change: float
    interval: Interval  # 95 % of the change, over sounds


def repeated(sounds: Sequence[Sound], minutes: int, minute_s: float = MINUTE_S) -> list[Sound]:
    """Each sound cut to a minute (a shorter one fills it again and again), `minutes` times in a row.

    Raises:
        EchoAvatarError: fewer than two minutes, which cannot differ.
    """
    if minutes < 2:
        raise EchoAvatarError(f"--minutes {minutes}: drift needs two minutes or more")
    size = int(minute_s * SAMPLE_RATE_HZ)
    return [sound._replace(audio=np.tile(np.resize(sound.audio, size), minutes)) for sound in sounds]


def minute(take: Take, number: int, minute_s: float = MINUTE_S) -> Take:
    """The part of a take that is in this minute; the first is 1."""
    frames = int(minute_s * FRAME_RATE_HZ)
    start, stop = (number - 1) * frames, min(number * frames, take.motion.frames)
    heard = None if take.audio is None else take.audio[start * SAMPLES_PER_FRAME : stop * SAMPLES_PER_FRAME]
    return take._replace(motion=take.motion.cut(start, stop), audio=heard)


def drifts(
    takes: Sequence[Take],
    between: tuple[int, int],
    seconds: float,
    *,
    minute_s: float = MINUTE_S,
    progress: Progress | None = None,
) -> dict[str, list[Drift]]:
    """The rows by kind of sound, those that change most surely first; windows are `seconds` long.

    Takes of the same name (performances with other seeds) count as one sound.
    """
    pairs: dict[tuple[str, str], list[tuple[Statistics, Statistics]]] = {}
    for take in watched(takes, progress):
        sides = tuple(_rows(minute(take, number, minute_s), seconds) for number in between)
        pairs.setdefault((take.kind, take.name), []).append((sides[0], sides[1]))
    found = {}
    for kind in dict.fromkeys(kind for kind, _ in pairs):
        own = [several for (of, _), several in pairs.items() if of == kind]
        names = [name for name in own[0][0][0] if any(np.isfinite(one[0][name]) for several in own for one in several)]
        found[kind] = sorted((_drift(name, own) for name in names), key=_sureness, reverse=True)
    return found


def _rows(take: Take, seconds: float) -> Statistics:
    """Means over the windows: `alive`'s by name, then the jury's."""
    windows = measure(take, seconds).windows
    names = {**dict.fromkeys(windows[0], windows), **dict.fromkeys(NAMES, tells_of_windows(take, seconds))}
    return {name: weighted_mean(np.array([row.get(name, NAN) for row in rows])) for name, rows in names.items()}


def _drift(name: str, own: Sequence[Sequence[tuple[Statistics, Statistics]]]) -> Drift:
    minutes = (zip(*several, strict=True) for several in own)
    sides = np.array([[weighted_mean(np.array([row[name] for row in side])) for side in pair] for pair in minutes])
    sides = sides[np.isfinite(sides).all(1)]
    if not len(sides):
        return Drift(name, NAN, NAN, NAN, UNKNOWN)
    change = sides[:, 1] - sides[:, 0]
    earlier, later = sides.mean(0).tolist()
    return Drift(name, earlier, later, float(change.mean()), _student(change))


def _student(change: Float[np.ndarray, " n"]) -> Interval:
    """Student's interval of the mean: sounds are few, and resampling few makes intervals far too narrow."""
    if len(change) < 2:
        return UNKNOWN
    half = float(stats.t.ppf((1 + LEVEL) / 2, len(change) - 1) * stats.sem(change))
    return Interval(float(change.mean()) - half, float(change.mean()) + half)


def _sureness(row: Drift) -> float:
    """The change in half widths of its interval; 0 where it has none."""
    half = (row.interval.high - row.interval.low) / 2
    return abs(row.change) / (half + 1e-9) if np.isfinite(half) else 0.0


def is_sure(row: Drift) -> bool:
    """Whether the interval of the change leaves out 0."""
    return bool(row.interval.low > 0 or row.interval.high < 0)


def as_text(found: Mapping[str, Sequence[Drift]], between: tuple[int, int]) -> str:
    """A table for each kind of sound."""
    first, last = between
    lines = []
    for kind, rows in found.items():
        lines.append(f"{kind:<38}{f'minute {first}':>12}{f'minute {last}':>12}{'change':>10}{'95 %':>20}")
        for row in rows:
            ends = "-" if np.isnan(row.interval.low) else f"{row.interval.low:.3f} to {row.interval.high:.3f}"
            lines.append(f"{marked(row.name):<38}{row.earlier:>12.3f}{row.later:>12.3f}{row.change:>+10.3f}{ends:>20}")
        lines.append(f"surely changed: {sum(map(is_sure, rows))} of {len(rows)}; about {len(rows) / 20:.0f} by chance")
    return "\n".join([*lines, LEGEND])


def as_json(found: Mapping[str, Sequence[Drift]]) -> dict[str, dict[str, object]]:
    """By kind of sound: how many rows surely changed, and each row as [earlier, later, change, from, to]."""
    return {
        kind: {
            "surely_changed": sum(map(is_sure, rows)),
            "rows": {row.name: [*map(rounded, (row.earlier, row.later, row.change, *row.interval))] for row in rows},
        }
        for kind, rows in found.items()
    }
