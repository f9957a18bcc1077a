"""A classifier that looks at the movement itself: can it tell ours from people's? A judge: nothing may be tuned to it.

No reward, target or choice of ours may be paid for what it says, and none of its people may train anything; else it
judges no more. It knows none of our statistics. It sees windows of 3 s: places and velocities of hands, elbows, head,
trunk and hips in the frame of the body, on a body of common measures, so that a rig's own measures give nobody away. A
thousand fixed random convolutions describe each window (Dempster et al., ROCKET, 2020, doi 10.1007/s10618-020-00701-z),
and a ridge classifier judges the description. It judges people that it was not fitted on, where there are two, and
clips of ours that it was not fitted on. People are judged beside: each person against the others, and, as a control,
each of some captured people in our place: few judges talk for more than seconds, so a talker is told from them by that.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from sklearn.linear_model import RidgeClassifierCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.formats import read_bvh
from echoavatar.timing import FRAME_RATE_HZ

from .metrics.distributions import LogOdds, held_out_right, parts
from .metrics.liveliness import MUSIC, SILENCE, SPEECH, Points, in_shoulder_frame
from .metrics.tells import JUDGED
from .table import LEVEL, NAN, SAMPLES, UNKNOWN, Interval
from .takes import Take, points_of, told_by_path

WINDOW_S, HOP_S = 3.0, 1.5
KERNELS, TAPS, DILATIONS, SEEN = 1024, 9, (1, 2, 4, 8), 4  # channels that one kernel sees: about 4
AT_ONCE = 256  # windows
OURS, CONTROL, PEOPLE = "ours", "captured people in our place, mean", "people, mean"
DECAYS = np.logspace(-1, 5, 7)
_WORDS = {MUSIC: ("dance",), SILENCE: ("idle",), SPEECH: ("",)}  # what is neither dance nor idle gestures


class Told(NamedTuple):
    """How often a side is told rightly from the others: 0.5 by chance, 1 always."""

    accuracy: float
    interval: Interval  # 95 %, from resampling the clips of both sides


class Seen(NamedTuple):
    """One window."""

    person: str
    clip: str
    channels: Float[np.ndarray, "c t"]


def read_judges(folder: Path) -> list[Take]:
    """People whom nothing was trained on: a path with "dance" dances, one with "idle" is left out, all others talk.

    Each folder should hold one person. Raises EchoAvatarError if there is none, or one cannot be read.
    """
    takes = []
    for path, said, kind in told_by_path(folder, _WORDS):
        if kind not in (None, SILENCE) and (motion := read_bvh(path)).seconds >= WINDOW_S:
            takes.append(Take(said, kind, path.parent.name, motion))
    if not takes:
        raise EchoAvatarError(f"{folder} holds nobody who talks or dances (.bvh of 3 s and more); see docs/metrics.md")
    return takes


def told_apart(ours: Sequence[Take], people: Sequence[Take], control: Sequence[Take] = ()) -> dict[str, Told]:
    """How `OURS` and the `CONTROL` are told from people, `PEOPLE` from one another in the mean, and each by its folder.

    All takes are of one kind of sound. Empty if a side has no window of 3 s; NaN if it has a single one.
    """
    made, known, true = ([one for take in takes for one in _windows(take)] for takes in (ours, control, people))
    if not made or not true:
        return {}
    described = _described(np.stack([one.channels for one in (*made, *known, *true)]))
    own, held, others = np.split(described, [len(made), len(made) + len(known)])
    found, each, controls = {OURS: _told(own, [one.clip for one in made], others, true)}, {}, []
    for person in dict.fromkeys(one.person for one in known):
        is_it = np.array([one.person == person for one in known])
        clips = [one.clip for one in known if one.person == person]
        controls.append(_told(held[is_it], clips, others, true))
    if controls:
        found[CONTROL] = _mean(controls)
    for person in dict.fromkeys(one.person for one in true):
        is_it = np.array([one.person == person for one in true])
        rest = [one for one in true if one.person != person]
        if rest:
            clips = [one.clip for one in true if one.person == person]
            each[person] = _told(others[is_it], clips, others[~is_it], rest)
    if each:
        found[PEOPLE] = _mean(list(each.values()))
    return found | each


def _mean(several: Sequence[Told]) -> Told:
    ends = np.mean([one.interval for one in several], axis=0)
    return Told(float(np.mean([one.accuracy for one in several])), Interval(*ends.tolist()))


def _told(
    own: Float[np.ndarray, "n d"], clips: Sequence[str], others: Float[np.ndarray, "m d"], people: Sequence[Seen]
) -> Told:
    """One side against people, of whom none is on both sides of a fold if there are two."""
    clips, their_clips = parts(clips), parts([one.clip for one in people])
    persons = [one.person for one in people]
    folds = persons if len(set(persons)) > 1 else their_clips
    if min(len(set(clips)), len(set(folds))) < 2:
        return Told(NAN, UNKNOWN)
    right = held_out_right(own, others, clips, folds, fitted=_ridge)
    accuracy = float(np.mean([side.mean() for side in right]))
    return Told(accuracy, _interval(list(zip(right, (clips, their_clips), strict=True))))


def _interval(sides: Sequence[tuple[np.ndarray, Sequence[str]]]) -> Interval:
    random, means = np.random.default_rng(0), []
    for right, clips in sides:
        own = [right[np.array(clips) == clip] for clip in dict.fromkeys(clips)]
        if len(own) < 2:
            return UNKNOWN
        draws = random.integers(len(own), size=(SAMPLES, len(own)))
        hits, sizes = (np.array(values)[draws].sum(1) for values in ([x.sum() for x in own], [len(x) for x in own]))
        means.append(hits / sizes)
    low, high = np.quantile(np.mean(means, 0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(float(low), float(high))


def _ridge(features: np.ndarray, label: np.ndarray) -> LogOdds:
    model = make_pipeline(StandardScaler(), RidgeClassifierCV(DECAYS, class_weight="balanced"))
    odds: Callable[[np.ndarray], np.ndarray] = model.fit(features, label).decision_function
    return odds


def _windows(take: Take) -> Iterable[Seen]:
    channels = movement(points_of(take))
    size, hop = (round(seconds * FRAME_RATE_HZ) for seconds in (WINDOW_S, HOP_S))
    for at in range(0, len(channels) - size + 1, hop):
        yield Seen(take.group, take.name, channels[at : at + size].T)


def movement(points: Points) -> Float[np.ndarray, "t c"]:
    """Places and velocities in the frame of the shoulders, of a body of common measures; `points` are `JUDGED`.

    An arm's bones are half an arm long, the trunk is one. Trunk, head and height of the hips are about the clip's mean,
    because rigs put these joints in different places. A Gaussian of one frame hides what cameras add.
    """
    smooth = gaussian_filter1d(points, 1, axis=0)
    at = {name: smooth[:, number] for number, name in enumerate(JUDGED)}
    middle, hips = ((at[f"left{bone}"] + at[f"right{bone}"]) / 2 for bone in ("UpperArm", "UpperLeg"))

    def unit(bone: np.ndarray) -> np.ndarray:
        turned = in_shoulder_frame(smooth, bone)
        return np.asarray(turned / (np.linalg.norm(turned, axis=1, keepdims=True) + 1e-9))

    places = []
    for side in ("left", "right"):
        elbow = unit(at[side + "LowerArm"] - at[side + "UpperArm"]) / 2
        places += [elbow, elbow + unit(at[side + "Hand"] - at[side + "LowerArm"]) / 2]
    places += [bone - bone.mean(0) for bone in (unit(middle - hips), unit(at["head"] - at["neck"]))]
    body = np.concatenate(places, 1)
    travel = in_shoulder_frame(smooth, np.gradient(at["hips"], axis=0)) * FRAME_RATE_HZ
    height = at["hips"][:, 1:2] - at["hips"][:, 1].mean()
    return np.concatenate([body, height, np.gradient(body, axis=0) * FRAME_RATE_HZ, travel], 1)


@torch.inference_mode()
def _described(windows: Float[np.ndarray, "n c t"]) -> Float[np.ndarray, "n d"]:
    """Of each kernel's output the share above 0 and the highest value; a quarter of the kernels for each dilation."""
    spread = windows.std((0, 2), keepdims=True) + 1e-6
    scaled = torch.from_numpy((windows - windows.mean((0, 2), keepdims=True)) / spread).float()
    random, shape = torch.Generator().manual_seed(0), (KERNELS // len(DILATIONS), windows.shape[1], TAPS)
    kernels = []
    for _ in DILATIONS:
        weights = torch.randn(shape, generator=random)
        is_seen = torch.rand(*shape[:2], 1, generator=random) < SEEN / shape[1]
        bias = 2 * torch.rand(shape[0], generator=random) - 1
        kernels.append(((weights - weights.mean(2, keepdim=True)) * is_seen, bias))
    rows = []
    for start in range(0, len(scaled), AT_ONCE):
        some = scaled[start : start + AT_ONCE]
        outs = [
            F.conv1d(some, *kernel, dilation=dilation, padding="same")
            for kernel, dilation in zip(kernels, DILATIONS, strict=True)
        ]
        rows.append(torch.cat([f for out in outs for f in ((out > 0).float().mean(2), out.amax(2))], 1))
    return torch.cat(rows).double().numpy()
