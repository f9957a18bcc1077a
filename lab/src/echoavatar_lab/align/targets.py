"""The rewards of `align targets`: for timing, for realism against an opponent, and for measures short of a target.

`align grpo` judges one motion after another, with any function of a motion. Here all continuations of a step are
measured together (`batch_motion`): 512 of ten seconds take half a second on a GPU. Rewards are not weighed by hand. The
weight of a measure grows while its mean is short of the target, so one run can keep many measures at once: a target
that is met costs nothing, and one that is missed is paid for. It is the method of multipliers with a weight between two
bounds. Not in the paper.

The targets are those that the default bundle's generator was tuned with: shares of another generator's means. A tuned
generator keeps time, dances and talks as much as the one before it (`like`), and looks more like a person. Only
measurements of this module are comparable with each other: windows here are shorter than those of `evaluate`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from pydantic import Field
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from echoavatar.config import Config
from echoavatar.timing import FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.evaluation.metrics.distributions import Classifier, fit
from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, POINTS, SPEECH, STATISTICS
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .batch_motion import hands_still, liveliness, of_common_height, smoothed, timing
from .decoded_motion import decode_behind
from .prompts import Prompt
from .realism import DOMAINS, MOST, kind_of_sound
from .rewards import JsonFile, Rewards

GAIN = 0.1  # of the log weight, for a mean that is short by all of its target
MOST_SHORT = 0.4  # of the target; a mean that is further off does not move the weight faster
MEMORY = 0.7  # share of the earlier mean in a new one


class Target(Config):
    """The wanted mean of a measure, and the bounds of the weight that its reward has."""

    aim: float = Field(gt=0, description="wanted mean")
    is_least: bool = Field(default=True, description="whether the mean should be at least, not at most, `aim`")
    weight: float = Field(gt=0, description="weight at the start")
    low: float = Field(gt=0, description="smallest weight")
    high: float = Field(gt=0, description="largest weight")

    @property
    def sign(self) -> float:
        """1 where more is wanted, -1 where less is."""
        return 1.0 if self.is_least else -1.0


class Weights:
    """The weights of all targets by name."""

    def __init__(self, targets: Mapping[str, Target]) -> None:
        self.targets = dict(targets)
        self.values = {name: target.weight for name, target in targets.items()}
        self.means: dict[str, float] = {}

    def see(self, name: str, mean: float) -> None:
        """Move the weight of a target after a batch with this mean; a mean that is not finite changes nothing."""
        if not math.isfinite(mean):
            return
        target = self.targets[name]
        self.means[name] = MEMORY * self.means.get(name, mean) + (1 - MEMORY) * mean
        short = target.sign * (target.aim - self.means[name]) / target.aim
        moved = self.values[name] * math.exp(GAIN * min(MOST_SHORT, max(-MOST_SHORT, short)))
        self.values[name] = min(target.high, max(target.low, moved))


LEAST = 1e-3  # of an aim: a generator that has not learnt to keep time may hit less than chance
TOLD_APART = 0.8  # accuracy of the opponent, which has seen hundreds of such windows


def _share(share: float, weight: float, low: float, high: float, *, is_least: bool = True) -> Target:
    return Target(aim=share, is_least=is_least, weight=weight, low=low, high=high)


GOALS = {  # targets whose aim is a share of the other generator's mean
    "music.beats": _share(0.95, 3.0, 1.0, 10.0),
    "speech.stresses": _share(0.95, 1.5, 0.5, 6.0),
    "music.jerk": _share(0.88, 0.05, 0.005, 0.6, is_least=False),
    "speech.jerk": _share(1.0, 0.03, 0.003, 0.4, is_least=False),
    "music.hands_still": _share(1.0, 0.03, 0.003, 0.3, is_least=False),
    "music.trunk_lean": _share(1.0, 0.03, 0.002, 0.4),
    "music.shoulder_turn": _share(1.03, 0.03, 0.002, 0.4),
    "music.hip_sway": _share(0.9, 0.02, 0.002, 0.3),
    "speech.room": _share(0.95, 0.02, 0.002, 0.3),
    "speech.trunk_lean": _share(1.0, 0.02, 0.002, 0.3),
    "speech.hip_sway": _share(0.9, 0.01, 0.001, 0.3),
    "speech.hand_speed": _share(0.85, 0.01, 0.001, 0.3),
    "speech.ankle_speed": _share(0.8, 0.01, 0.001, 0.2),
    "rest": _share(1.1, 0.03, 0.003, 0.5, is_least=False),
}


class Targets(JsonFile):
    """The targets of a run, as they are kept beside it."""

    remedy = "targets; remove it, and `echoavatar align targets` sets them anew"

    targets: dict[str, Target] = Field(description="targets by name")


def targets_like(means: Mapping[str, float]) -> dict[str, Target]:
    """Targets from another generator's means (`means_of`).

    Raises KeyError if its continuations were not of both kinds of sound.
    """
    told = {
        "music.told_apart": Target(aim=TOLD_APART, is_least=False, weight=0.12, low=0.03, high=0.5),
        "speech.told_apart": Target(aim=TOLD_APART, is_least=False, weight=0.04, low=0.01, high=0.2),
    }
    aims = {name: max(LEAST, share.aim * means[name]) for name, share in GOALS.items()}
    return told | {name: GOALS[name].model_copy(update={"aim": aim}) for name, aim in aims.items()}


KEPT_WINDOWS = 1500  # of the policy's windows
FEWEST_WINDOWS = 60  # of the policy's windows before the first fit
EVERY = 3  # batches between fits
COUNT = len(STATISTICS)


class Opponent:
    """A classifier that learns during the run, for one kind of sound: is a window a person's or this policy's?

    The realism reward is fitted once. This one is fitted again to the policy's latest windows every few batches, as the
    discriminator of an adversarial network is, so that no trick against one classifier pays for long. That needs
    hundreds of windows a batch: with a hundred it brought less than the fixed one.
    """

    def __init__(self, people: Float[np.ndarray, "n 9"]) -> None:
        """`people` are the statistics of people's windows."""
        self.people, self.own = people, np.zeros((0, COUNT))
        self._classifier: Classifier | None = None
        self._batches = 0

    def see(self, windows: Float[np.ndarray, "m 9"]) -> float | None:
        """Learn from a batch; returns how surely the classifier of before tells it from people, 0.5 to 1."""
        accuracy = None
        if self._classifier is not None and len(windows):
            is_told = (
                (self._classifier.log_odds(windows) > 0).mean(),
                (self._classifier.log_odds(self.people) <= 0).mean(),
            )
            accuracy = float(np.mean(is_told))
        self.own = np.concatenate([self.own, windows])[-KEPT_WINDOWS:]
        if self._batches % EVERY == 0 and len(self.own) >= FEWEST_WINDOWS:
            sides = np.concatenate([self.own, self.people])
            self._classifier = fit(sides, np.repeat([1.0, 0.0], [len(self.own), len(self.people)]))
        self._batches += 1
        return accuracy

    def odds(self, windows: Float[np.ndarray, "m 9"]) -> Float[np.ndarray, " m"]:
        """Log odds that windows are a person's, within -4 and 4; 0 before the first fit."""
        if self._classifier is None:
            return np.zeros(len(windows))
        return np.asarray(np.clip(-self._classifier.log_odds(windows), -MOST, MOST))

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `load_state` needs."""
        fitted = {} if self._classifier is None else self._classifier._asdict()
        return {"own": self.own, "batches": np.array(self._batches)} | fitted

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on where `state` was taken."""
        fitted = {name: value for name, value in state.items() if name not in ("own", "batches")}
        self.own, self._batches = state["own"], int(state["batches"])
        self._classifier = Classifier(**fitted) if fitted else None


TOGETHER = 256  # continuations decoded and measured at a time
MOST_PAID = 3.0  # multiples of a target's aim beyond which nothing more is paid
MOST_JERK = 4.0  # the same for the jerk of a frame
FRAME_SCALE = 10.0  # jerk and rest are paid by frame, where they count for a second and not for the whole
REST_M_S = 0.4  # of hands in speech, roughly; hands in silence are paid over it
STILL = "music.hands_still"  # paid in the frames where it happens
TIMING = {MUSIC: "beats", SPEECH: "stresses"}

Kinds = Shaped[np.ndarray, " r"]
"""The kind of sound of each row, "" where no kind fills it."""


class Measured(NamedTuple):
    """Continuations, measured."""

    beats: Float[Tensor, "r n"]  # excess over chance, by frame
    stresses: Float[Tensor, "r n"]
    jerk: Float[Tensor, "r n"]  # m/s3, mean over joints about the hips
    hands: Float[Tensor, "r n"]  # their speed about the hips, m/s
    still: Bool[Tensor, "r n"]  # both hands
    silent: Bool[Tensor, "r n"]
    statistics: Float[np.ndarray, "r 9"]
    stands: Bool[np.ndarray, " r"]  # upright, and every statistic finite


@torch.no_grad()
def measured(tokenizer: BodyTokenizer, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> Measured:
    """Measure continuations; the rows of one prompt follow each other, the same number for each."""
    group, device = len(codes) // len(prompts), codes.device

    def rows(name: str) -> Tensor:
        stacked = np.stack([getattr(prompt, name) for prompt in prompts]).astype(np.int64)
        return torch.from_numpy(stacked).to(device).repeat_interleave(group, 0)

    beats, stresses = (
        _padded([getattr(prompt, name) for prompt in prompts]).to(device).repeat_interleave(group, 0)
        for name in ("beats", "stresses")
    )
    skeleton, past = tokenizer.skeleton, rows("past")
    points = [skeleton.index(name) for name in POINTS]
    parts: list[tuple[Tensor, ...]] = []
    for start in range(0, len(codes), TOGETHER):
        at = slice(start, start + TOGETHER)
        _, positions = decode_behind(tokenizer, past[at], codes[at])
        lead = positions.shape[1] - codes.shape[1] * FRAMES_PER_MOTION_TOKEN
        body, stands = of_common_height(positions[:, lead:][:, :, points])
        about = positions - positions[:, :, :1]
        jerk = torch.diff(about, n=3, dim=1).norm(dim=-1).mean(2)[:, lead - 3 :] * FRAME_RATE_HZ**3
        hands = smoothed(about, 1.0, "nearest")[:, :, list(skeleton.indices(("leftHand", "rightHand")))]
        speed = torch.diff(hands, dim=1).norm(dim=-1).mean(2)[:, lead - 1 :] * FRAME_RATE_HZ
        hit = timing(skeleton, positions, lead, beats[at], stresses[at])
        parts.append((*hit, jerk, speed, hands_still(body), liveliness(body), stands))
    on_beats, on_stresses, jerk, hands, still, statistics, stands = (
        torch.cat(part) for part in zip(*parts, strict=True)
    )
    silent = (rows("domain") == 0).repeat_interleave(FRAMES_PER_MOTION_TOKEN, 1)
    table = statistics.cpu().numpy()
    is_sound = stands.cpu().numpy() & np.isfinite(table).all(1)
    return Measured(on_beats, on_stresses, jerk, hands, still, silent, table, is_sound)


def kind_of(prompt: Prompt) -> str:
    """The kind of sound that fills the continuation, or nothing."""
    return kind_of_sound(prompt.domain)


def kinds_of(prompts: Sequence[Prompt]) -> Kinds:
    """`kind_of` each prompt."""
    return np.array([kind_of(prompt) for prompt in prompts])


def means_of(found: Measured, kinds: Kinds) -> dict[str, float]:
    """Means of all measures that may have a target, by "kind.name", and "rest": the speed of hands in silence."""
    means: dict[str, float] = {}
    for kind in TIMING:
        own = kinds == kind
        if own.any():
            columns = dict(zip(STATISTICS, found.statistics.T, strict=True))
            columns |= {"jerk": found.jerk.mean(1).cpu().numpy()}
            columns |= {TIMING[kind]: getattr(found, TIMING[kind]).sum(1).cpu().numpy()}
            means |= {f"{kind}.{name}": float(np.nanmean(column[own])) for name, column in columns.items()}
    means["rest"] = float((found.hands * found.silent).sum() / found.silent.sum().clamp(min=1))
    return means


class TargetJudge:
    """Judges a batch, moves the targets' weights, and teaches the opponents (a `probe.Judge`)."""

    def __init__(
        self, tokenizer: BodyTokenizer, people: Mapping[str, Float[np.ndarray, "n 9"]], targets: Mapping[str, Target]
    ) -> None:
        """`people` holds statistics of people's windows by kind of sound; `targets` are of `targets_like`."""
        self.tokenizer = tokenizer
        self.opponents = {kind: Opponent(rows) for kind, rows in people.items()}
        self.weights = Weights(targets)
        self.told: dict[str, float] = {}  # means of the last batch and weights, for the log

    def __call__(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> Rewards:
        """Rewards of continuations."""
        found = measured(self.tokenizer.to(codes.device), prompts, codes)
        kinds = kinds_of(prompts).repeat(len(codes) // len(prompts))
        self._learn(found, kinds)
        realism = self._realism(found, kinds)
        tokens, whole = self._by_frame(found, kinds), realism + self._by_target(found, kinds)
        parts = {"beats": found.beats.sum(1), "stresses": found.stresses.sum(1)}
        return Rewards(
            tokens.view(len(tokens), -1, FRAMES_PER_MOTION_TOKEN).sum(2).double().cpu().numpy(),
            whole,
            {name: value.double().cpu().numpy() for name, value in parts.items()} | {"realism": realism},
        )

    def _learn(self, found: Measured, kinds: Kinds) -> None:
        means = means_of(found, kinds)
        for kind, opponent in self.opponents.items():
            accuracy = opponent.see(found.statistics[(kinds == kind) & found.stands])
            if accuracy is not None:
                means[f"{kind}.told_apart"] = accuracy
        for name in self.weights.targets:
            if name in means:
                self.weights.see(name, means[name])
        self.told = means | {f"weight.{name}": value for name, value in self.weights.values.items()}

    def _realism(self, found: Measured, kinds: Kinds) -> Float[np.ndarray, " r"]:
        """Rewards for looking like a person to the opponents; a body that does not stand surely looks like none."""
        paid = np.zeros(len(kinds))
        for kind, opponent in self.opponents.items():
            own = kinds == kind
            odds = np.full(len(kinds), -MOST)
            odds[own & found.stands] = opponent.odds(found.statistics[own & found.stands])
            paid[own] = odds[own] * self.weights.values[f"{kind}.told_apart"]
        return paid

    def _by_target(self, found: Measured, kinds: Kinds) -> Float[np.ndarray, " r"]:
        """Rewards of whole continuations for their statistics, as shares of the aims."""
        paid, columns = np.zeros(len(kinds)), dict(zip(STATISTICS, np.nan_to_num(found.statistics).T, strict=True))
        for name, target in self.weights.targets.items():
            kind, _, what = name.partition(".")
            if what in columns and name != STILL:
                share = np.minimum(columns[what] / target.aim, MOST_PAID)
                paid += (kinds == kind) * target.sign * self.weights.values[name] * share
        return paid

    def _by_frame(self, found: Measured, kinds: Kinds) -> Float[Tensor, "r n"]:
        """Rewards for hits, jerk, still hands in music and hands in silence, in the frames where they happen."""
        weights, frames = self.weights.values, found.beats.shape[1]
        is_kind = {kind: torch.from_numpy(kinds == kind).to(found.beats.device)[:, None] for kind in DOMAINS}
        paid = weights["music.beats"] * found.beats + weights["speech.stresses"] * found.stresses
        for kind in DOMAINS:
            jerk = (found.jerk / self.weights.targets[f"{kind}.jerk"].aim).clamp(max=MOST_JERK)
            paid = paid - is_kind[kind] * weights[f"{kind}.jerk"] * FRAME_SCALE * jerk / frames
        still = is_kind[MUSIC] * found.still / self.weights.targets[STILL].aim
        paid = paid - weights[STILL] * FRAME_SCALE * still / frames
        return paid - weights["rest"] * FRAME_SCALE * found.silent * found.hands / REST_M_S / frames


def _padded(events: Sequence[Float[np.ndarray, " e"]]) -> Float[Tensor, "b e"]:
    """Events of all rows, with at least one NaN behind the last of each."""
    rows = [torch.from_numpy(own).float() for own in events]
    return F.pad(pad_sequence(rows, batch_first=True, padding_value=math.nan), (0, 1), value=math.nan)
