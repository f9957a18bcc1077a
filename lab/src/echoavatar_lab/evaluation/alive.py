"""`echoavatar evaluate BUNDLE alive`: how much the body moves and varies, beside people.

The bundle performs recorded speech and music, stands in silence and listens. Every window of that motion is measured
(`metrics.liveliness`), and so is captured motion, where the user has some. Shorter windows, half overlapping, are
compared as sets: by a Fréchet distance and by how often a classifier tells ours from captured.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar_lab.data.statistics import turned_feet
from echoavatar_lab.progress import Progress, watched
from echoavatar_lab.training.curves import save_figure

from .metrics.distributions import frechet_distance, held_out_accuracy, parts, scaled_by_truth
from .metrics.liveliness import (
    KINDS,
    LISTENING,
    SILENCE,
    SPEECH,
    STATISTICS,
    arm_rests,
    body_points,
    jerk,
    liveliness,
    windows,
)
from .paid_for import LEGEND, marked
from .people import of_card
from .pictures import contact_sheet
from .table import mean_interval, rounded, weighted_mean
from .takes import Sound, Take, joined, perform, points_of

QUIET_TAKES = 3  # of silence, and of listening
COMPARED_S = 10.0  # windows of the Fréchet distance and of the classifier
SHOWN = (*STATISTICS, "jerk", "turned_feet")  # of each window of a take
RESTING = ("rest_s", "rest_share")  # of both arms; rows show the worst, since means over performances hide it
_MADE, _CAPTURED = "#1f5fa8", "#8a8a8a"
_STILLS, _STILL_SIZE = 12, (90, 130)
WORST = 39 / 40  # of the windows are no worse

Statistics = dict[str, float]


@dataclass(frozen=True)
class Measured:
    """A take's statistics: in each of its windows, and in the shorter ones that are compared as sets."""

    take: Take
    windows: list[Statistics]
    compared: list[Statistics]


@dataclass
class AliveReport:
    """All of a run: takes, rows of means by their label, and per kind the two comparisons with captured motion.

    With several performances, rows are means over them, and the rows called "scatter" their standard deviation.
    """

    made: list[Measured]
    captured: list[Measured]
    rows: dict[str, Statistics] = field(default_factory=dict)
    frechet: dict[str, float] = field(default_factory=dict)
    told_apart: dict[str, float] = field(default_factory=dict)  # accuracy on held-out windows, and people's among them


def performance(
    pipeline: Pipeline, sounds: Sequence[Sound], seconds: float, *, seed: int = 0, progress: Progress | None = None
) -> list[Take]:
    """The avatar's motion to the sounds, in silence, and while a user says the first sounds of speech.

    `progress` receives the chunks done and the chunks in all. It does not count those of listening.
    """
    quiet = [
        Sound(f"silence {n + 1}", SILENCE, "", np.zeros(int(seconds * SAMPLE_RATE_HZ), np.float32))
        for n in range(QUIET_TAKES)
    ]
    takes = perform(pipeline, [*sounds, *quiet], seed=seed, progress=progress)
    users = [sound for sound in sounds if sound.kind == SPEECH][:QUIET_TAKES]
    heard = [_listening(pipeline, sound.audio, seed + number) for number, sound in enumerate(users)]
    return takes + [Take(f"listening to {s.name}", LISTENING, "", m) for s, m in zip(users, heard, strict=True)]


def measure(take: Take, seconds: float) -> Measured:
    """Measure windows of `seconds`, and windows of 10 s every 5 s.

    Raises MotionError if the rig is not known; names the take.
    """
    points = points_of(take, body_points)
    fps = take.motion.fps
    short, hop = int(COMPARED_S * fps), int(COMPARED_S * fps / 2)
    compared = [liveliness(points[at : at + short], fps) for at in range(0, len(points) - short + 1, hop)]
    whole = [
        liveliness(part, fps)
        | {"jerk": jerk(part, fps), "turned_feet": float(turned.mean())}
        | dict(zip(RESTING, arm_rests(part, fps), strict=True))
        for part, turned in zip(
            windows(points, fps, seconds), windows(turned_feet(take.motion), fps, seconds), strict=True
        )
    ]
    return Measured(take, whole, compared)


def report(
    performances: Sequence[Sequence[Take]],
    captured: Sequence[Take],
    seconds: float,
    *,
    progress: Progress | None = None,
) -> AliveReport:
    """Measure all takes of one or more performances and compare each with captured motion, kind by kind."""
    takes = watched([*itertools.chain(*performances), *captured], progress)
    measured = (measure(take, seconds) for take in takes)
    made = [list(itertools.islice(measured, len(own))) for own in performances]
    found = AliveReport(list(itertools.chain(*made)), list(measured))
    for kind in KINDS:
        each = [[one for one in takes if one.take.kind == kind] for takes in made]
        ours = list(itertools.chain(*each))
        theirs = [one for one in found.captured if one.take.kind == captured_kind(kind)]
        if not ours:
            continue
        found.rows[kind] = mean_statistics(ours)
        groups = dict.fromkeys(one.take.group for one in ours if one.take.group)
        found.rows |= {f"{kind}: {g}": mean_statistics([o for o in ours if o.take.group == g]) for g in groups}
        if len(each) > 1:
            found.rows[f"{kind}, scatter"] = scatter(each)
        found.rows |= people_rows(kind, theirs)
        if theirs:
            compared = np.array([compare(takes, theirs) for takes in each])
            found.frechet[kind], found.told_apart[kind] = map(float, compared.mean(0))
            found.told_apart[f"{kind}, people"] = people_apart(theirs)
            found.rows |= {f"{kind}, {label}": row for label, row in by_statistic(each, theirs).items()}
            if len(each) > 1:
                found.frechet[f"{kind}, scatter"], found.told_apart[f"{kind}, scatter"] = map(
                    float, compared.std(0, ddof=1)
                )
            if kind == captured_kind(kind):  # once: listening has the same people as silence
                for person, accuracy in each_apart(theirs).items():
                    own = [one for one in theirs if one.take.group == person]
                    found.rows[f"{kind}, people: {person}"] = mean_statistics(own)
                    found.told_apart[f"{kind}, people: {person}"] = accuracy
    return found


def people_rows(kind: str, theirs: Sequence[Measured]) -> dict[str, Statistics]:
    """Means and intervals over the named people (without clips: of the default bundle's card).

    Of named people each weighs the same; `stillest` and `RESTING` are of all their windows.
    """
    if not theirs:
        found = of_card()[kind]
        means: Statistics = {name: one.mean for name, one in found.items()}
        ends = {name: one.interval for name, one in found.items()}
    else:
        each = [mean_statistics([one for one in theirs if one.take.group == who]) for who in _persons(theirs)]
        columns = {name: np.array([row[name] for row in each]) for name in SHOWN}
        means = mean_statistics(theirs) | {name: weighted_mean(column) for name, column in columns.items()}
        ends = {name: mean_interval(column[np.isfinite(column)]) for name, column in columns.items()}
    return {
        f"{kind}, people": means,
        f"{kind}, people, 95 % from": {name: end.low for name, end in ends.items()},
        f"{kind}, people, 95 % to": {name: end.high for name, end in ends.items()},
    }


def _persons(theirs: Sequence[Measured]) -> list[str]:
    return list(dict.fromkeys(one.take.group for one in theirs))


def captured_kind(kind: str) -> str:
    """The kind of captured motion to compare with: people who stand idle, for listening too."""
    return SILENCE if kind == LISTENING else kind


def compare(ours: Sequence[Measured], theirs: Sequence[Measured]) -> tuple[float, float]:
    """Fréchet distance of the windows' statistics, scaled by the captured ones, and the classifier's accuracy.

    The distance is NaN if a side has fewer than two windows.
    """
    (made, made_clips), (true, true_clips) = (_table(side) for side in (ours, theirs))
    if min(len(made), len(true)) < 2:
        return float("nan"), float("nan")
    return frechet_distance(*scaled_by_truth(made, true)), held_out_accuracy(made, true, made_clips, true_clips)


def by_statistic(performances: Sequence[Sequence[Measured]], theirs: Sequence[Measured]) -> dict[str, Statistics]:
    """What tells ours from captured: medians of both sides' windows, and the classifier's accuracy with one statistic.

    Medians, because one break dancer moves a mean more than all others. The accuracy is the mean over performances.
    Empty if a side has no window.
    """
    (true, true_clips), tables = _table(theirs), [_table(takes) for takes in performances]
    if not len(true) or not all(len(made) for made, _ in tables):
        return {}
    together = np.concatenate([made for made, _ in tables])
    return {
        "median": dict(zip(STATISTICS, map(float, np.median(together, 0)), strict=True)),
        "people, median": dict(zip(STATISTICS, map(float, np.median(true, 0)), strict=True)),
        "told apart by one": {
            name: float(
                np.mean([held_out_accuracy(made[:, [at]], true[:, [at]], clips, true_clips) for made, clips in tables])
            )
            for at, name in enumerate(STATISTICS)
        },
    }


def people_apart(captured: Sequence[Measured]) -> float:
    """How well the classifier tells captured people from one another: the mean of `each_apart`.

    Hold the accuracy of `compare` against it. NaN with fewer than two folders.
    """
    accuracies = list(each_apart(captured).values())
    return float(np.mean(accuracies)) if accuracies else float("nan")


def each_apart(captured: Sequence[Measured]) -> dict[str, float]:
    """How well the classifier tells each folder of captured people from all the others.

    A folder should hold one person: several people in one are told from the rest less surely than each of them. The
    only clip of a side is cut in quarters.
    """
    accuracies = {}
    for group in dict.fromkeys(one.take.group for one in captured):
        sides = [[one for one in captured if (one.take.group == group) is is_in] for is_in in (True, False)]
        (some, clips), (others, other_clips) = (_table(side) for side in sides)
        if len(some) and len(others):
            accuracies[group] = held_out_accuracy(some, others, parts(clips), parts(other_clips))
    return accuracies


def mean_statistics(measured: Iterable[Measured]) -> Statistics:
    """Means over all windows; NaN where no window has a value.

    `stillest` is the largest share of `hands_still`. Of `RESTING` it is the value that `WORST` of the windows keep to.
    """
    rows = [row for one in measured for row in one.windows]
    means = {name: weighted_mean(np.array([row[name] for row in rows])) for name in SHOWN}
    worst = {name: float(np.quantile([row[name] for row in rows], WORST, method="inverted_cdf")) for name in RESTING}
    return means | {"stillest": max(row["hands_still"] for row in rows)} | worst


def scatter(performances: Sequence[Sequence[Measured]]) -> Statistics:
    """Standard deviation of each mean between performances."""
    means = [mean_statistics(takes) for takes in performances]
    return {name: float(np.std([row[name] for row in means], ddof=1)) for name in means[0]}


def as_text(found: AliveReport) -> str:
    """A table with a row for each kind, class and reference."""
    columns = [*SHOWN, "stillest", *RESTING, "frechet", "told_apart"]
    width = max(map(len, found.rows))
    lines = [" " * width + "".join(f"{marked(name):>15}" for name in columns)]
    for label, row in found.rows.items():
        cells = row | {"frechet": found.frechet.get(label), "told_apart": found.told_apart.get(label)}
        values = [cells.get(name) for name in columns]
        lines.append(
            label.ljust(width) + "".join(f"{'-' if v is None or np.isnan(v) else f'{v:.2f}':>15}" for v in values)
        )
    return "\n".join([*lines, LEGEND])


def as_json(found: AliveReport) -> dict[str, dict[str, float | None]]:
    """Rows, Fréchet distances and accuracies by name; null for missing values."""
    parts = found.rows | {"frechet": found.frechet, "told_apart": found.told_apart}
    return {label: {name: rounded(value) for name, value in row.items()} for label, row in parts.items()}


def _listening(pipeline: Pipeline, user: Float[np.ndarray, " s"], seed: int) -> Motion:
    """Motion in silence while the user speaks."""
    size, made = pipeline.chunk.samples, list[MotionChunk]()
    with Engine(pipeline, rewind=0, workers=0).open(seed=seed) as session:
        for at in range(0, len(user) - size + 1, size):
            session.listen(user[at : at + size])
            session.push(np.zeros(size, np.float32))
            made.extend(session)
    return joined(pipeline.skeleton, made)


def _table(side: Sequence[Measured]) -> tuple[Float[np.ndarray, "n d"], list[str]]:
    rows = [(list(row.values()), one.take.name) for one in side for row in one.compared]
    kept = [(values, name) for values, name in rows if np.isfinite(values).all()]
    return np.array([values for values, _ in kept]).reshape(-1, len(STATISTICS)), [name for _, name in kept]


def sheet(takes: Sequence[Take]) -> UInt8[np.ndarray, "h w 3"]:
    """A row of twelve stills for each take, in the order of the takes."""
    rows = [contact_sheet(take.motion, columns=_STILLS, rows=1, size=_STILL_SIZE) for take in takes]
    return np.concatenate(rows)


def draw(found: AliveReport, path: Path) -> None:
    """Write a panel for each statistic: a dot for each window, grey for captured ones, a bar for people's range.

    Raises EchoAvatarError if the picture cannot be written.
    """
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    people = of_card()
    for axis, (name, unit) in zip(figure.subplots(3, 3).flat, STATISTICS.items(), strict=True):
        for place, kind in enumerate(KINDS):
            one = people[kind][name]
            mean = found.rows.get(f"{kind}, people", {}).get(name, one.mean)
            theirs = [m for m in found.captured if m.take.kind == captured_kind(kind)]
            values = [v for m in theirs for row in m.windows if np.isfinite(v := row[name])]
            axis.vlines(place, min(values, default=one.low), max(values, default=one.high), color="#d9d9d9", lw=16)
            axis.hlines(mean, place - 0.22, place + 0.22, color="#5c5c5c", lw=1.5)
            _dots(axis, place + 0.13, found.captured, captured_kind(kind), name, _CAPTURED)
            _dots(axis, place - 0.13, found.made, kind, name, _MADE)
        axis.set_xticks(range(len(KINDS)), KINDS, fontsize=8)
        axis.set_title(f"{name}{f' ({unit})' if unit else ''}", fontsize=9)
        axis.tick_params(axis="y", labelsize=8)
    figure.suptitle(
        "blue: windows of the bundle; grey dots: captured; bar and line: range and mean of the named people", fontsize=9
    )
    save_figure(figure, path)


def _dots(axis: Any, place: float, measured: Sequence[Measured], kind: str, name: str, colour: str) -> None:
    values = [row[name] for one in measured if one.take.kind == kind for row in one.windows]
    axis.plot([place] * len(values), values, "o", color=colour, ms=3.5, alpha=0.6, mew=0)
