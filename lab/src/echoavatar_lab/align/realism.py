"""The realism reward: log odds that a body is a captured person's rather than this generator's. Not in the paper.

A classifier is fitted to windows of the generator's own continuations and to windows of captured people of the same
length. It is the classifier of `evaluate BUNDLE alive` and reads the same statistics. Rewards of timing alone make
bodies that are told from people more surely; this one rewards the opposite.

The classifier stays as it is during a run, so a resumed run repeats itself. It knows the generator that it was fitted
to: after some tens of steps fit it again, to the tuned one.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.timing import CHUNK_SECONDS, FRAME_RATE_HZ
from echoavatar_lab.evaluation.metrics.distributions import Classifier, fit, held_out_accuracy
from echoavatar_lab.evaluation.metrics.liveliness import (
    APART_S,
    MUSIC,
    POINTS,
    SPEECH,
    STATISTICS,
    Points,
    body_points,
    liveliness,
    of_common_height,
)
from echoavatar_lab.evaluation.takes import Take
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.progress import Progress

from .decoded_motion import DecodedMotion, decode_continuations
from .policy import GeneratorPolicy, continuations
from .prompts import PromptSampler
from .rewards import JsonFile, ReferenceStatistics

DOMAINS = {SPEECH: 1, MUSIC: 2}
PURE = 0.85  # share of the frames that one kind of sound must fill
MOST = 4.0  # log odds beyond which nothing more is paid
HOP = 0.3  # of a window: from one captured window to the next
FEWEST = 20  # windows of a side; a kind with fewer is left out
COUNT = len(STATISTICS)

Window = tuple[str, str, Float[np.ndarray, " d"]]
"""Kind of sound, clip, statistics."""


class KindConfig(Config):
    """A fitted classifier of one kind of sound (`metrics.distributions.Classifier`)."""

    mean: tuple[float, ...] = Field(min_length=COUNT, max_length=COUNT, description="means of the statistics")
    spread: tuple[float, ...] = Field(min_length=COUNT, max_length=COUNT, description="deviations of the statistics")
    weights: tuple[float, ...] = Field(
        min_length=1 + 2 * COUNT, max_length=1 + 2 * COUNT, description="of a constant, the statistics, their squares"
    )


class Realism(JsonFile):
    """Classifiers for windows of one length, by kind of sound."""

    remedy = "realism reward; make one with `echoavatar align reward-realism`"

    seconds: float = Field(gt=0, description="length of a window: a continuation")
    kinds: dict[Literal["speech", "music"], KindConfig] = Field(description="a classifier for each kind of sound")

    def judge(self, motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
        """Log odds that the continuation is a person's, within -4 and 4; 0 for a kind of sound without classifier.

        Raises EchoAvatarError if the continuation has another length than the windows.
        """
        seconds = motion.frames / FRAME_RATE_HZ
        if abs(seconds - self.seconds) > 0.5 / FRAME_RATE_HZ:
            raise EchoAvatarError(
                f"the realism reward judges continuations of {self.seconds / CHUNK_SECONDS:.0f} chunks, not of"
                f" {seconds / CHUNK_SECONDS:.0f}: fit it with the same --length"
            )
        kind = kind_of_sound(motion.domain[motion.lead :])
        if kind not in self.kinds:
            return 0.0
        found, known = _statistics(_points(motion, motion.frames), FRAME_RATE_HZ, seconds), self.kinds[kind]
        if not np.isfinite(found).all():
            return -MOST
        classifier = Classifier(*(np.array(values) for values in (known.mean, known.spread, known.weights)))
        return float(np.clip(-classifier.log_odds(found[None])[0], -MOST, MOST))


def fit_realism(
    policy: GeneratorPolicy,
    tokenizer: BodyTokenizer,
    book: PromptSampler,
    captured: Sequence[Take],
    *,
    length: int,
    prompts: int = 96,
    group: int = 4,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Realism, Mapping[str, Mapping[str, float]]]:
    """Fit to the last `length` chunks of the policy's continuations of `book`'s prompts and to captured windows.

    Returns the reward, and for each kind the numbers of windows and how surely held-out ones are `told_apart`. Raises
    EchoAvatarError if no kind of sound has 20 windows of each side.
    """
    seconds = length * CHUNK_SECONDS
    frames = round(seconds * FRAME_RATE_HZ)
    made: list[Window] = []
    for drawn, codes in continuations(policy, book, prompts=prompts, group=group, seed=seed, progress=progress):
        for row, motion in enumerate(decode_continuations(tokenizer, drawn, codes)):
            statistics = _statistics(_points(motion, frames), FRAME_RATE_HZ, seconds)
            made.append((kind_of_sound(motion.domain[-frames:]), drawn[row // group].clip, statistics))
    true = list(_captured_windows(captured, seconds))
    kinds, found, counts = {}, {}, {}
    for kind in DOMAINS:
        (ours, our_clips), (theirs, their_clips) = _of_kind(made, kind), _of_kind(true, kind)
        counts[kind] = (len(ours), len(theirs))
        if min(counts[kind]) < FEWEST:
            continue
        found[kind] = {
            "generated": len(ours),
            "captured": len(theirs),
            "told_apart": held_out_accuracy(ours, theirs, our_clips, their_clips),
        }
        fitted = fit(np.concatenate([ours, theirs]), np.repeat([1.0, 0.0], counts[kind]))
        kinds[kind] = KindConfig(**{name: tuple(map(float, value)) for name, value in fitted._asdict().items()})
    if not kinds:
        raise EchoAvatarError(
            f"windows of {seconds:.1f} s, generated and captured: {counts}; at least {FEWEST} of each are needed:"
            " raise --prompts, or add captured clips"
        )
    return Realism(seconds=seconds, kinds=kinds), found  # type: ignore[arg-type]


def _captured_windows(captured: Sequence[Take], seconds: float) -> Iterator[Window]:
    for take in captured:
        if take.kind not in DOMAINS:
            continue
        points, fps = body_points(take.motion), take.motion.fps
        size = int(seconds * fps)
        for start in range(0, len(points) - size + 1, max(1, int(HOP * size))):
            yield take.kind, take.name, _statistics(points[start : start + size], fps, seconds)


def _of_kind(windows: Sequence[Window], kind: str) -> tuple[Float[np.ndarray, "n d"], list[str]]:
    """The statistics, where all are finite, of windows of a kind of sound, and the clips of these windows."""
    kept = [window for window in windows if window[0] == kind and np.isfinite(window[2]).all()]
    return np.array([statistics for _, _, statistics in kept]), [clip for _, clip, _ in kept]


def kind_of_sound(domain: np.ndarray) -> str:
    """The kind of sound that fills a continuation, given its domain by frame or token; or nothing."""
    return next((kind for kind, number in DOMAINS.items() if (domain == number).mean() >= PURE), "")


def _points(motion: DecodedMotion, frames: int) -> Points | None:
    """The last frames as points of a body of common height; None if it does not stand upright."""
    at = [motion.skeleton.index(name) for name in POINTS]
    try:
        return of_common_height(motion.positions[-frames:, at].astype(np.float64))
    except MotionError:
        return None


def _statistics(points: Points | None, fps: float, seconds: float) -> Float[np.ndarray, " d"]:
    """The statistics of a window. Seconds that `novelty` compares are as far apart as fits, at most 3 s."""
    if points is None:
        return np.full(COUNT, np.nan)
    return np.array(list(liveliness(points, fps, apart_s=min(APART_S, (seconds - 1.3) / 2)).values()))
