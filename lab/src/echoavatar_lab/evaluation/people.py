"""The captured people beside the avatar: one list of named clips, and their statistics with intervals over people.

`people.csv` beside this file names every clip by its place in a data folder, which the user gives, with its kind, its
person, and whether it may train anything (`use`). Every column of people comes from these clips: rows of `alive` and
of `data describe`, the jury's range, what targets and rewards learn. A user with other clips writes a list of their
own, `people.csv` in their folder. `echoavatar evaluate BUNDLE people --captured FOLDER --card CARD` measures the list
and writes the numbers into a card; the default bundle's card has those of ours, for whoever has no clips.
"""

from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.models.audio import read_audio
from echoavatar.models.audio.files import sound_named
from echoavatar.motion.formats import read_bvh
from echoavatar_lab.foreign.csv_rows import read_rows
from echoavatar_lab.progress import Progress, watched

from .metrics.liveliness import LISTENING, MUSIC, SILENCE, SPEECH, STATISTICS, body_points, liveliness, windows
from .table import Interval, mean_interval, rounded
from .takes import Take, points_of

LIST, COLUMNS = "people.csv", ("kind", "person", "use", "clip")
KINDS = (SPEECH, MUSIC, SILENCE)
USES = ("any", "evaluation")
SHORTEST_S, WINDOW_S = 10.0, 30.0


class Named(NamedTuple):
    """A line of the list."""

    kind: str
    person: str
    use: str
    clip: str  # path in the data folder


class Measure(NamedTuple):
    """One statistic of the people of a kind."""

    mean: float  # each person weighs the same
    interval: Interval  # 95 %, over people
    low: float  # lowest window of any person
    high: float


Statistics = Mapping[str, Mapping[str, Measure]]  # by kind and statistic


def named_clips(folder: Path) -> list[Named]:
    """The list of the folder, or else ours.

    Raises:
        EchoAvatarError: the list is damaged or empty.
    """
    own = folder / LIST
    if own.is_file():
        return _read(own)
    with as_file(files(__package__) / LIST) as path:
        return _read(path)


def read_people(folder: Path, *, for_training: bool = False) -> list[Take]:
    """The named clips below a folder, by person; each with the sound of the same name beside it, if there is one.

    `for_training` leaves out the clips that may only be used for evaluation.

    Raises:
        EchoAvatarError: a named clip is not there, cannot be read, or is shorter than 10 s.
    """
    listed = [one for one in named_clips(folder) if one.use == "any" or not for_training]
    missing = [one.clip for one in listed if not (folder / one.clip).is_file()]
    if missing:
        raise EchoAvatarError(
            f"{folder} lacks {len(missing)} of the {len(listed)} named clips, such as {missing[0]}; give the folder"
            f" that holds them, or name your own in {folder / LIST} (columns {', '.join(COLUMNS)}; docs/metrics.md)"
        )
    takes = []
    for kind, person, _, clip in listed:
        motion, sound = read_bvh(folder / clip), sound_named((folder / clip).with_suffix(""))
        if motion.seconds < SHORTEST_S:
            raise MotionError(f"{folder / clip} lasts {motion.seconds:.1f} s, a named clip {SHORTEST_S:g} s or more")
        takes.append(Take(clip, kind, person, motion, read_audio(sound) if sound else None))
    return takes


def measured(
    takes: Sequence[Take], seconds: float = WINDOW_S, *, progress: Progress | None = None
) -> dict[str, dict[str, list[dict[str, float]]]]:
    """The statistics of every window of `seconds`, by kind and person; a shorter clip is one window.

    Raises:
        MotionError: a rig is not known; names the clip.
    """
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for take in watched(takes, progress):
        points = points_of(take, body_points)
        rows = [liveliness(part, take.motion.fps) for part in windows(points, take.motion.fps, seconds)]
        found.setdefault(take.kind, {}).setdefault(take.group, []).extend(rows)
    return found


def statistics(rows: Mapping[str, Mapping[str, Iterable[Mapping[str, float]]]]) -> dict[str, dict[str, Measure]]:
    """Means over people, intervals over people, and the lowest and highest window, from rows by kind and person."""
    found: dict[str, dict[str, Measure]] = {}
    for kind, people in rows.items():
        found[kind] = {}
        for name in STATISTICS:
            each = [np.array([row[name] for row in own]) for own in people.values()]
            known = [own[np.isfinite(own)] for own in each if np.isfinite(own).any()]
            if known:
                means, every = np.array([own.mean() for own in known]), np.concatenate(known)
                ends = mean_interval(means)
                found[kind][name] = Measure(float(means.mean()), ends, float(every.min()), float(every.max()))
    return found


def as_json(rows: Mapping[str, Mapping[str, Sequence[Mapping[str, float]]]]) -> dict[str, object]:
    """For a card: per kind the names of the people, windows, and each statistic as [mean, 95 % from, to, low, high]."""
    found = statistics(rows)
    return {
        kind: {
            "people": list(people),
            "windows": sum(map(len, people.values())),
            "statistics": {name: [*map(rounded, (m.mean, *m.interval, m.low, m.high))] for name, m in of.items()},
        }
        for (kind, people), of in zip(rows.items(), found.values(), strict=True)
    }


def of_card(path: Path | None = None) -> dict[str, dict[str, Measure]]:
    """The statistics that a card holds; None: the default bundle's card. People who listen are those who stand.

    Raises:
        EchoAvatarError: the card has none, or they are damaged.
    """
    with as_file(files("echoavatar") / "bundles/default/card.json") as own:
        place = path or own
        try:
            stored: Any = read_object_file(place)["people"]
            found = {kind: {n: _measure(v) for n, v in stored[kind]["statistics"].items()} for kind in KINDS}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise EchoAvatarError(
                f"{place} holds no statistics of people ({error}); write them with `echoavatar evaluate BUNDLE people"
                " --captured FOLDER --card CARD`"
            ) from error
    return found | {LISTENING: found[SILENCE]}


def as_text(found: Statistics) -> str:
    """A table for each kind."""
    lines = []
    for kind, of in found.items():
        lines.append(f"{kind:<16}{'people':>9}{'95 % over people':>20}{'lowest':>9}{'highest':>9}")
        for name, one in of.items():
            ends = "-" if np.isnan(one.interval.low) else f"{one.interval.low:.2f} to {one.interval.high:.2f}"
            lines.append(f"{name:<16}{one.mean:>9.2f}{ends:>20}{one.low:>9.2f}{one.high:>9.2f}")
    return "\n".join(lines)


def _measure(values: Sequence[float | None]) -> Measure:
    mean, first, last, low, high = (float("nan") if value is None else float(value) for value in values)
    return Measure(mean, Interval(first, last), low, high)


def _read(path: Path) -> list[Named]:
    rows = [Named(*(row[name] for name in COLUMNS)) for row in read_rows(path, COLUMNS)]
    for line, row in enumerate(rows, 2):
        if row.kind not in KINDS or row.use not in USES or not row.clip or Path(row.clip).is_absolute():
            raise EchoAvatarError(
                f"{path}, line {line}: {','.join(row)!r} is no clip; give kind ({', '.join(KINDS)}), person, use"
                f" ({' or '.join(USES)}) and a path in the folder"
            )
    if not rows:
        raise EchoAvatarError(f"{path} names no clip; add lines of {', '.join(COLUMNS)}")
    return rows
