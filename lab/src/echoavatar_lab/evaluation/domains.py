"""`echoavatar evaluate BUNDLE domains`: how often the body dances to speech, and gestures to music.

Paper, Discussions: male speech is taken for song, and the avatar dances. Measured here: a frame is danced if the ankles
travel faster than `ANKLES` in the mean over the two seconds around it. It is gestured if it is not danced and the
wrists move faster than `HANDS` about the shoulders. Other frames are rest. Both limits are those that tell captured
people apart best (`limits`): dancers from all others, and people who talk from people who wait. How well they do is
measured on performers who did not choose them (`held_out`).
"""

import re
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.progress import Progress, watched

from . import takes
from .metrics.liveliness import MUSIC, SPEECH, body_points, foot_paths, hand_paths, path_speed
from .table import UNKNOWN, Interval, mean_interval
from .takes import Sound, Take, told_by_path

AROUND_S = 2.0
ANKLES = 0.60  # metres a second, of a body whose head joint is 1.5 m above its ankles
HANDS = 0.12  # arm lengths a second
WAITING, TALKING, SIGNALLING, DANCING = "waiting", "talking", "signalling and laughing", "dancing"
BOTH = "both"
MIXED, BELOW_DB = 3, (0, 12)  # such sounds, and how much quieter than the voice the music is
_WORDS = {
    DANCING: ("dance",),
    WAITING: ("idle",),
    TALKING: ("speech", "conversation", "talk"),
    SIGNALLING: ("gesture",),
}
_STEPS = 100  # values that are tried for a limit


class Pace(NamedTuple):
    """How fast ankles and wrists move, in the mean over the two seconds around each frame."""

    ankles: Float[np.ndarray, " t"]
    hands: Float[np.ndarray, " t"]


class Limits(NamedTuple):
    """Speeds above which a frame is danced (of the ankles, metres a second) or gestured (of the hands, arm lengths)."""

    ankles: float = ANKLES
    hands: float = HANDS


DEFAULT = Limits()


class Shares(NamedTuple):
    """One class of sound: its length, and the shares of its frames, 0 to 1; the rest is neither.

    The 95 % intervals resample sounds, with all their takes, or performers.
    """

    kind: str
    group: str
    takes: int
    seconds: float
    danced: float
    gestured: float
    danced_interval: Interval = UNKNOWN
    gestured_interval: Interval = UNKNOWN


class Person(NamedTuple):
    """A captured take: its performer, kind, pace and length."""

    performer: str
    kind: str
    pace: Pace
    seconds: float


def pace(motion: Motion) -> Pace:
    """How fast a body on any known rig moves ankles and wrists. Raises MotionError if the rig is not known."""
    points, fps = body_points(motion), motion.fps
    return Pace(*(_around(paths, fps) for paths in (foot_paths(points), hand_paths(points))))


def danced_gestured(found: Pace, chosen: Limits = DEFAULT) -> tuple[np.ndarray, np.ndarray]:
    """Whether each frame is danced, and whether it is gestured."""
    danced = found.ankles > chosen.ankles
    return danced, (found.hands > chosen.hands) & ~danced


def read_sounds(folder: Path, seconds: float, most: int, *, split: str = "dev") -> list[Sound]:
    """The sounds of `takes.read_sounds` by classes of voice, and up to three mixtures of speech and music, twice.

    Music is as loud as the voice, and 12 dB quieter. Raises EchoAvatarError if no sound is left.
    """
    sounds = takes.read_sounds(folder, seconds, most, class_of=voice, split=split)
    spoken, played = ([sound for sound in sounds if sound.kind == kind] for kind in (SPEECH, MUSIC))
    mixed = []
    for below, (one, other) in product(BELOW_DB, zip(spoken[:MIXED], played[:MIXED], strict=False)):
        size, share = min(len(one.audio), len(other.audio)), 10 ** (-below / 20)
        audio = one.audio[:size] / _loudness(one.audio) + share * other.audio[:size] / _loudness(other.audio)
        audio *= _loudness(one.audio) / np.hypot(1, share)
        mixed.append(Sound(f"{one.name} over {other.name}", BOTH, spoken_over(below), audio.astype(np.float32)))
    return sounds + mixed


def spoken_over(below: int) -> str:
    """The class of a mixture whose music is so many dB quieter than the voice."""
    return f"spoken word over music, {f'{below} dB quieter' if below else 'as loud'} (mixed)"


def voice(row: dict[str, str]) -> str:
    """The class of a manifest's row: of speech the sex, where it is told, and the manner; of music the genre."""
    told = re.split(r"[\[]", row["language_or_genre"])[0].strip()
    if row["kind"] != SPEECH:
        return told
    manner = told.partition(", ")[2] or "read"
    if "emotion" in manner:
        manner = "acted anger" if "anger" in row.get("title", "") else "acted, other emotions"
    sex = re.search(r"\(([MFmw])[,\d]|\((f)\d", row["speaker_or_artist"])
    return f"{'male' if sex[1] in ('M', 'm') else 'female'}, {manner}" if sex else f"sex not told, {manner}"


def read_people(folder: Path, *, progress: Progress | None = None) -> list[Person]:
    """Captured takes of at least 2 s whose path says what they are: "dance", "idle", "talk", "speech", "gesture".

    A performer is what a file's name says before the first underscore. Raises EchoAvatarError if there are no dancers,
    nobody who talks, or nobody who waits; or a file cannot be read.
    """
    found, paths = [], told_by_path(folder, _WORDS)
    for path, _, kind in watched(paths, progress):
        if kind and (motion := read_bvh(path)).seconds >= AROUND_S:
            performer = f"{path.parent.name}/{path.stem.partition('_')[0]}"
            try:
                found.append(Person(performer, kind, pace(motion), motion.seconds))
            except MotionError as error:
                raise MotionError(f"{path}: {error}") from error
    if missing := [kind for kind in (WAITING, TALKING, DANCING) if all(one.kind != kind for one in found)]:
        raise EchoAvatarError(
            f"{folder} holds nobody {' and nobody '.join(missing)} (.bvh of 2 s and more, with 'dance', 'idle' or"
            " 'talk' in the path); see docs/metrics.md"
        )
    return found


def limits(people: Sequence[Person]) -> Limits:
    """The limits that tell these people apart best, kind against kind with equal weight.

    Ankles tell those who dance from those who talk, wait, signal or laugh; hands tell those who talk from those who
    wait.
    """

    def of(kind: str, which: int) -> np.ndarray:
        return np.concatenate([one.pace[which] for one in people if one.kind == kind] or [np.zeros(0)])

    ankles = _between([slow for kind in _WORDS if kind != DANCING and len(slow := of(kind, 0))], of(DANCING, 0))
    return Limits(ankles, _between([of(WAITING, 1)], of(TALKING, 1)))


def held_out(people: Sequence[Person]) -> list[Shares]:
    """The shares of captured people, each measured with limits that were chosen without that performer."""
    marked: dict[str, list[Marks]] = {}
    for performer in dict.fromkeys(one.performer for one in people):
        others = [one for one in people if one.performer != performer]
        has_all = {WAITING, TALKING, DANCING} <= {one.kind for one in others}
        chosen = limits(others if has_all else people)
        for one in people:
            if one.performer == performer:
                marked.setdefault(one.kind, []).append((performer, *danced_gestured(one.pace, chosen)))
    return [
        _share("captured", kind, marks, sum(one.seconds for one in people if one.kind == kind))
        for kind, marks in sorted(marked.items(), key=lambda item: list(_WORDS).index(item[0]))
    ]


def shares(performed: Iterable[Take]) -> list[Shares]:
    """The shares of every class, and of each kind as a whole (class "all"), in order of kind and class."""
    kept = [(take, (take.name, *danced_gestured(pace(take.motion)))) for take in performed]
    groups = dict.fromkeys((take.kind, group) for take, _ in kept for group in ("all", take.group) if group)
    rows = []
    for kind, group in sorted(groups, key=lambda key: (key[0], key[1] != "all", key[1])):
        own = [(take, marks) for take, marks in kept if take.kind == kind and group in ("all", take.group)]
        rows.append(_share(kind, group, [marks for _, marks in own], sum(take.motion.seconds for take, _ in own)))
    return rows


def as_text(rows: Sequence[Shares]) -> str:
    """A table in Markdown; shares in percent."""
    lines = ["| sound | class | takes | s | danced, % | gestured, % |", "|---|---|---:|---:|---:|---:|"]
    for row in rows:
        told = (_percent(row.danced, row.danced_interval), _percent(row.gestured, row.gestured_interval))
        numbers = f"{row.takes} | {row.seconds:.0f} | {' | '.join(told)}"
        lines.append(f"| {row.kind} | {row.group} | {numbers} |")
    return "\n".join(lines)


Marks = tuple[str, np.ndarray, np.ndarray]  # the sound or performer; which frames are danced, which gestured


def _share(kind: str, group: str, marks: Sequence[Marks], seconds: float) -> Shares:
    names = list(dict.fromkeys(mark[0] for mark in marks))

    def of(which: int) -> tuple[float, Interval]:
        each = [np.concatenate([mark[which] for mark in marks if mark[0] == name]) for name in names]
        frames = np.array([float(len(one)) for one in each])
        return float(np.concatenate(each).mean()), mean_interval(np.array([one.mean() for one in each]), frames)

    (danced, danced_in), (gestured, gestured_in) = of(1), of(2)
    return Shares(kind, group, len(marks), seconds, danced, gestured, danced_in, gestured_in)


def _percent(share: float, found: Interval) -> str:
    spread = f" [{100 * found.low:.1f}, {100 * found.high:.1f}]" if np.isfinite(found.low) else ""
    return f"{100 * share:.1f}{spread}"


def _around(paths: Float[np.ndarray, "t 2 3"], fps: float) -> Float[np.ndarray, " t"]:
    """Mean speed of two points in the two seconds around each frame."""
    if len(paths) < 2:
        return np.zeros(len(paths))
    speed = np.mean([path_speed(paths[:, point], fps) for point in range(2)], axis=0)
    frames = min(len(speed), round(AROUND_S * fps))
    return np.asarray(uniform_filter1d(np.concatenate([speed[:1], speed]), frames, mode="nearest"))


def _between(slow: Sequence[np.ndarray], fast: np.ndarray) -> float:
    """The limit with the highest mean of the shares on the right side of it, the slow kinds weighing alike."""
    tried = np.quantile(np.concatenate([*slow, fast]), np.linspace(0.01, 0.99, _STEPS))
    right = [np.mean([(one <= limit).mean() for one in slow]) + (fast > limit).mean() for limit in tried]
    return float(tried[int(np.argmax(right))])


def _loudness(audio: Float[np.ndarray, " s"]) -> float:
    return float(np.sqrt(np.mean(np.square(audio)))) or 1.0
