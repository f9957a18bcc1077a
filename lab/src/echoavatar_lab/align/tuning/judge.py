"""What continuations earn: timing, realism against an opponent, and whatever is short of its target."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.timing import FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.align.prompts import Prompt
from echoavatar_lab.align.realism import DOMAINS, MOST, PURE
from echoavatar_lab.align.rewards import Rewards
from echoavatar_lab.evaluation.metrics.liveliness import MUSIC, POINTS, SPEECH, STATISTICS

from .movement import hands_still, liveliness, of_common_height
from .opponent import Opponent
from .positions import LEAD, shown_positions
from .targets import Target, Weights
from .timing import smoothed, timing

TOGETHER = 128  # continuations measured at a time
MOST_PAID = 3.0  # multiples of a target's aim beyond which nothing more is paid
MOST_JERK = 4.0  # the same for the jerk of a frame
FRAME_SCALE = 10.0  # jerk and rest are paid by frame, where they count for a second and not for the whole
REST_M_S = 0.4  # of hands in speech, roughly; hands in silence are paid over it
STILL = "music.hands_still"  # paid in the frames where it happens
TIMING = {MUSIC: "beats", SPEECH: "stresses"}


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
    skeleton = tokenizer.skeleton
    positions = shown_positions(tokenizer, rows("past"), codes)
    points = [skeleton.index(name) for name in POINTS]
    parts: list[tuple[Tensor, ...]] = []
    for start in range(0, len(codes), TOGETHER):
        at = slice(start, start + TOGETHER)
        body, stands = of_common_height(positions[at, LEAD:][:, :, points])
        about = positions[at] - positions[at, :, :1]
        jerk = torch.diff(about, n=3, dim=1).norm(dim=-1).mean(2)[:, LEAD - 3 :] * FRAME_RATE_HZ**3
        hands = smoothed(about, 1.0, "nearest")[:, :, list(skeleton.indices(("leftHand", "rightHand")))]
        speed = torch.diff(hands, dim=1).norm(dim=-1).mean(2)[:, LEAD - 1 :] * FRAME_RATE_HZ
        hit = timing(skeleton, positions[at], LEAD, beats[at], stresses[at])
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
    return next((kind for kind, number in DOMAINS.items() if (prompt.domain == number).mean() >= PURE), "")


def means_of(found: Measured, kinds: Sequence[str]) -> dict[str, float]:
    """What targets may be set for, by "kind.name", and "rest": the speed of hands in silence."""
    means: dict[str, float] = {}
    kind_of_row = np.array(kinds)
    for kind in dict.fromkeys(filter(None, kinds)):
        own = kind_of_row == kind
        columns = dict(zip(STATISTICS, found.statistics.T, strict=True))
        columns |= {"jerk": found.jerk.mean(1).cpu().numpy()}
        columns |= {TIMING[kind]: getattr(found, TIMING[kind]).sum(1).cpu().numpy()}
        means |= {f"{kind}.{name}": float(np.nanmean(column[own])) for name, column in columns.items()}
    means["rest"] = float((found.hands * found.silent).sum() / found.silent.sum().clamp(min=1))
    return means


class TargetJudge:
    """Judges a batch, moves the targets' weights, and teaches the opponents (`align.judge.Judge`)."""

    def __init__(
        self, tokenizer: BodyTokenizer, people: Mapping[str, Float[np.ndarray, "n 9"]], targets: Mapping[str, Target]
    ) -> None:
        """`people` holds statistics of people's windows by kind of sound; `targets` are of `goals`."""
        self.tokenizer = tokenizer
        self.opponents = {kind: Opponent(rows) for kind, rows in people.items()}
        self.weights = Weights(targets)
        self.told: dict[str, float] = {}  # what the last batch was like, for the log

    def __call__(self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]) -> Rewards:
        """Rewards of continuations."""
        found = measured(self.tokenizer.to(codes.device), prompts, codes)
        kinds = [kind for prompt in prompts for kind in [kind_of(prompt)] * (len(codes) // len(prompts))]
        self._learn(found, kinds)
        realism = self._realism(found, kinds)
        tokens, whole = self._by_frame(found, kinds), realism + self._by_target(found, kinds)
        parts = {"beats": found.beats.sum(1), "stresses": found.stresses.sum(1)}
        return Rewards(
            tokens.view(len(tokens), -1, FRAMES_PER_MOTION_TOKEN).sum(2).double().cpu().numpy(),
            whole,
            {name: value.double().cpu().numpy() for name, value in parts.items()} | {"realism": realism},
        )

    def _learn(self, found: Measured, kinds: Sequence[str]) -> None:
        means, kind_of_row = means_of(found, kinds), np.array(kinds)
        for kind, opponent in self.opponents.items():
            accuracy = opponent.see(found.statistics[(kind_of_row == kind) & found.stands])
            if accuracy is not None:
                means[f"{kind}.told_apart"] = accuracy
        for name in self.weights.targets:
            if name in means:
                self.weights.see(name, means[name])
        self.told = means | {f"weight.{name}": value for name, value in self.weights.values.items()}

    def _realism(self, found: Measured, kinds: Sequence[str]) -> Float[np.ndarray, " r"]:
        """What the opponents take for a person's; a body that does not stand is surely none."""
        paid, kind_of_row = np.zeros(len(kinds)), np.array(kinds)
        for kind, opponent in self.opponents.items():
            own = kind_of_row == kind
            odds = np.full(len(kinds), -MOST)
            odds[own & found.stands] = opponent.odds(found.statistics[own & found.stands])
            paid[own] = odds[own] * self.weights.values[f"{kind}.told_apart"]
        return paid

    def _by_target(self, found: Measured, kinds: Sequence[str]) -> Float[np.ndarray, " r"]:
        """What statistics earn: their share of the aim, for the whole continuation."""
        paid, columns = np.zeros(len(kinds)), dict(zip(STATISTICS, np.nan_to_num(found.statistics).T, strict=True))
        for name, target in self.weights.targets.items():
            kind, _, what = name.partition(".")
            if what in columns and name != STILL:
                share = np.minimum(columns[what] / target.aim, MOST_PAID)
                paid += (np.array(kinds) == kind) * target.sign * self.weights.values[name] * share
        return paid

    def _by_frame(self, found: Measured, kinds: Sequence[str]) -> Float[Tensor, "r n"]:
        """What hits, jerk, still hands in music and hands in silence earn, in the frames where they happen."""
        weights, frames = self.weights.values, found.beats.shape[1]
        paid = weights["music.beats"] * found.beats + weights["speech.stresses"] * found.stresses
        for kind in DOMAINS:
            own = torch.tensor([one == kind for one in kinds], device=paid.device)[:, None]
            jerk = (found.jerk / self.weights.targets[f"{kind}.jerk"].aim).clamp(max=MOST_JERK)
            paid = paid - own * weights[f"{kind}.jerk"] * FRAME_SCALE * jerk / frames
        in_music = torch.tensor([one == MUSIC for one in kinds], device=paid.device)[:, None]
        paid = paid - in_music * weights[STILL] * FRAME_SCALE * found.still / self.weights.targets[STILL].aim / frames
        return paid - weights["rest"] * FRAME_SCALE * found.silent * found.hands / REST_M_S / frames


def _padded(events: Sequence[Float[np.ndarray, " e"]]) -> Float[Tensor, "b e"]:
    """Events of all rows, NaN behind the last of each."""
    table = np.full((len(events), max(1, *map(len, events))), np.nan, np.float32)
    for row, own in zip(table, events, strict=True):
        row[: len(own)] = own
    return torch.from_numpy(table)
