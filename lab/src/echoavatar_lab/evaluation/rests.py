"""`echoavatar evaluate BUNDLE rests`: how long both arms rest while music plays or somebody talks, at the worst.

Means over seeds hide that one performance of six hangs its arms, so every performance counts. Music is the bundled
pieces and as many from the recordings. Where the sound is quiet, nothing asks for motion: such frames are left out.
"""

import itertools
from collections.abc import Iterable, Sequence
from importlib.resources import as_file, files
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.models.audio import read_audio
from echoavatar.timing import SAMPLE_RATE_HZ

from .metrics.liveliness import MUSIC, SPEECH, arm_rests, body_points, hand_paths, windows
from .takes import Sound, Take, points_of

MOST_S, MOST_SHARE = 3.0, 0.15  # the longest rest, and resting seconds, of a dance that is alive
TALK_S = 10.0  # windows of talk: few sentences go on for longer
QUIET, QUIET_S = 0.1, 1.0  # a sound whose level over that time is under that share (20 dB) of its own mean is quiet
HANGS = -0.75  # arm lengths over the shoulders: wrists under it hang; others rest before the body, as some dancers' do
SHOWN = 5  # performances with the longest rests


class Rests(NamedTuple):
    """The rests of both arms in a window of a take."""

    name: str
    kind: str
    longest_s: float
    share: float
    hanging: float  # share in which both hang meanwhile
    quiet: float  # share of the window in which the sound is quiet


def with_bundled(recorded: Sequence[Sound], seconds: float, most: int) -> list[Sound]:
    """Up to `most` pieces: in turn the recorded music and the bundled."""
    with as_file(files("echoavatar") / "assets") as folder:
        paths = [folder / "music.ogg", *sorted((folder / "music").glob("*.ogg"))]
        cut = int(seconds * SAMPLE_RATE_HZ)
        bundled = (Sound(path.stem, MUSIC, "bundled", read_audio(path)[:cut]) for path in paths)  # as far as needed
        turns = itertools.zip_longest([sound for sound in recorded if sound.kind == MUSIC], bundled)
        return list(itertools.islice((sound for turn in turns for sound in turn if sound), most))


def is_quiet(audio: Float[np.ndarray, " s"], frames: int) -> Bool[np.ndarray, " t"]:
    """For each of the frames that share the sound among them, whether it is quiet there."""
    loud = np.concatenate([[0.0], np.cumsum(np.square(audio, dtype=np.float64))])
    middle, half = (np.arange(frames) + 0.5) * len(audio) / frames, QUIET_S * SAMPLE_RATE_HZ / 2
    first, last = (np.clip(middle + side, 0, len(audio)).astype(int) for side in (-half, half))
    return np.asarray((loud[last] - loud[first]) / (last - first) < QUIET**2 * loud[-1] / len(audio))


def rests_of(take: Take, seconds: float) -> list[Rests]:
    """The rests in each window of a dance, or of `TALK_S` of a talk."""
    points, fps = points_of(take, body_points), take.motion.fps
    quiet = np.zeros(len(points), bool) if take.audio is None else is_quiet(take.audio, len(points))
    length = TALK_S if take.kind == SPEECH else seconds
    found = []
    for part, still in zip(windows(points, fps, length), windows(quiet, fps, length), strict=True):
        sounds = ~still[1:]
        hang = (hand_paths(part)[1:, :, 1] < HANGS).all(1)
        hanging = arm_rests(part, fps, sounds & hang)[1] * float((sounds & hang).sum() / max(sounds.sum(), 1))
        found.append(Rests(take.name, take.kind, *arm_rests(part, fps, sounds), hanging, float(still.mean())))
    return found


def as_text(made: Iterable[Rests], people: Iterable[Rests]) -> str:
    """A row for each kind of ours and of people, then the performances with the longest rests."""
    made, people = list(made), list(people)
    header = ["windows", "longest, s", "39 of 40", "mean", f"to {MOST_S:g} s"]
    header += ["share", "39 of 40", "mean", f"to {MOST_SHARE:g}", "hanging", "quiet"]
    lines = [" " * 16 + "".join(f"{name:>12}" for name in header)]
    for kind, (who, side) in itertools.product((MUSIC, SPEECH), (("ours", made), ("people", people))):
        if own := [one for one in side if one.kind == kind]:
            lines.append(f"{kind + ', ' + who:<16}" + "".join(f"{value:>12}" for value in _row(own)))
    for kind in (MUSIC, SPEECH):
        worst = sorted((one for one in made if one.kind == kind), key=lambda one: -one.longest_s)[:SHOWN]
        lines += [
            f"  {one.name:<40}{one.longest_s:>8.1f} s{one.share:>8.2f}{one.hanging:>8.2f}{one.quiet:>8.2f}"
            for one in worst
        ]
    return "\n".join(lines)


def as_json(made: Iterable[Rests]) -> dict[str, list[list[object]]]:
    """Each window of ours by kind: the fields of `Rests` but the kind."""
    found: dict[str, list[list[object]]] = {}
    for one in made:
        numbers = [round(value, 4) for value in one[2:]]
        found.setdefault(one.kind, []).append([one.name, *numbers])
    return found


def _row(own: Sequence[Rests]) -> list[str]:
    cells = [f"{len(own)}"]
    for values, most in (([one.longest_s for one in own], MOST_S), ([one.share for one in own], MOST_SHARE)):
        worst = np.quantile(values, 39 / 40, method="inverted_cdf")
        cells += [f"{number:.2f}" for number in (max(values), worst, np.mean(values))]
        cells.append(f"{sum(value <= most for value in values)}")
    return [*cells, *(f"{np.mean([getattr(one, name) for one in own]):.3f}" for name in ("hanging", "quiet"))]
