"""`echoavatar evaluate BUNDLE dial`: what the dials of a speaker's manner do, from one end to the other.

The same voices with the same seeds, once for each setting of `liveliness`, and then of `handedness`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from echoavatar.engine.pipeline import Pipeline
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.progress import Progress, watched

from .jury import Verdict, verdicts
from .metrics.liveliness import SPEECH, body_points, hand_paths, liveliness, path_speed
from .table import Interval, mean_interval
from .takes import Sound, Take, perform

SETTINGS = (0.0, 0.2, 0.3, 0.5, 0.8, 1.0)


class Setting(NamedTuple):
    """What one setting does; speeds in arm lengths per second, intervals of 95 % over voices."""

    dial: str  # "liveliness" or "handedness"
    value: float
    hand_speed: float
    interval: Interval
    hands_still: float  # share of frames in which neither hand moves
    right_share: float  # of the path of both hands
    rows: list[Verdict]  # the jury's, of speech; empty without captured people


def turn_dials(
    pipeline: Pipeline,
    sounds: Sequence[Sound],
    captured: Sequence[Take],
    seconds: float,
    *,
    seeds: Sequence[int] = (0,),
    progress: Progress | None = None,
) -> list[Setting]:
    """Each dial at each of `SETTINGS`, once with each of `seeds`; `progress` receives the settings done and in all.

    Raises:
        EchoAvatarError: the model was trained without manners, or there is no speech.
    """
    if not pipeline.has_manner:
        raise EchoAvatarError("the bundle's generator was trained without manners, so it has no dials to measure")
    voices = [sound for sound in sounds if sound.kind == SPEECH]
    if not voices:
        raise EchoAvatarError("the dials are of speech, and the recordings have none")
    told = [MotionOptions(liveliness=value) for value in SETTINGS]
    told += [MotionOptions(handedness=value) for value in SETTINGS]
    found = []
    for options in watched(told, progress):
        takes = [take for seed in seeds for take in perform(pipeline, voices, seed=seed, options=options)]
        found.append(_setting(options, takes, captured, seconds))
    return found


def _setting(options: MotionOptions, takes: Sequence[Take], captured: Sequence[Take], seconds: float) -> Setting:
    dial = "handedness" if options.liveliness is None else "liveliness"
    points = [body_points(take.motion) for take in takes]
    measured = [liveliness(one, FRAME_RATE_HZ) for one in points]
    speeds = np.array([row["hand_speed"] for row in measured])
    left, right = (
        sum(float(path_speed(hand_paths(one)[:, side], FRAME_RATE_HZ).sum()) for one in points) for side in (0, 1)
    )
    return Setting(
        dial,
        getattr(options, dial),
        float(speeds.mean()),
        mean_interval(speeds, np.ones(len(speeds))),
        float(np.mean([row["hands_still"] for row in measured])),
        right / (left + right),
        verdicts(takes, captured, seconds)[SPEECH] if captured else [],
    )


def as_text(settings: Sequence[Setting]) -> str:
    """A row for each setting."""
    lines = [f"{'dial':<12}{'at':>5}{'hands':>8}{'95 %':>14}{'still':>8}{'right':>8}{'outside':>9}{'worst':>8}"]
    for one in settings:
        span = f"{one.interval.low:.2f} to {one.interval.high:.2f}"
        jury = f"{_outside(one):>9}{_worst(one):>8.2f}" if one.rows else ""
        numbers = f"{one.hand_speed:>8.2f}{span:>14}{one.hands_still:>8.2f}{one.right_share:>8.2f}"
        lines.append(f"{one.dial:<12}{one.value:>5.1f}{numbers}{jury}")
    return "\n".join(lines)


def as_json(settings: Sequence[Setting]) -> dict[str, object]:
    """By dial and setting; `outside` counts the jury's rows, and is null without captured people."""
    return {
        f"{one.dial} {one.value:g}": {
            "hand_speed": round(one.hand_speed, 4),
            "interval": [round(end, 4) for end in one.interval],
            "hands_still": round(one.hands_still, 4),
            "right_share": round(one.right_share, 4),
            "outside": _outside(one) if one.rows else None,
            "worst": round(_worst(one), 4) if one.rows else None,
        }
        for one in settings
    }


def draw(settings: Sequence[Setting], path: Path) -> None:
    """Hand speed over liveliness, and the right hand's share over handedness, as a picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axis, dial in zip(figure.subplots(1, 2), ("liveliness", "handedness"), strict=True):
        own = [one for one in settings if one.dial == dial]
        at = [one.value for one in own]
        if dial == "liveliness":
            axis.fill_between(
                at, [one.interval.low for one in own], [one.interval.high for one in own], alpha=0.2, color="#1f5fa8"
            )
            axis.plot(at, [one.hand_speed for one in own], "o-", color="#1f5fa8")
            axis.set(ylabel="hand speed, arm lengths/s", ylim=(0, None))
        else:
            axis.plot(at, [one.right_share for one in own], "o-", color="#1f5fa8")
            axis.set(ylabel="share of the right hand", ylim=(0, 1))
        axis.set(xlabel=dial, xlim=(0, 1))
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def _outside(one: Setting) -> int:
    return sum(row.is_outside for row in one.rows)


def _worst(one: Setting) -> float:
    return float(np.nanmax([row.outside for row in one.rows]))
