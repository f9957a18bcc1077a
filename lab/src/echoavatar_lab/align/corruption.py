"""Corrupts motion by known amounts, to train the quality reward (paper, Corruption-based Quality Ordering).

Two kinds corrupt codes; the reward is trained on them. Four degrade the motion itself; they test whether the reward
generalises. The scores of the levels are the paper's table, or follow from FID measured on one's own data
(`scores_from_fid`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.features import travel_slice

Corruption = Literal["hierarchical", "uniform"]
Degradation = Literal["jitter", "time_warp", "foot_slide", "frozen_limbs"]
RATES = tuple(round(0.1 * k, 1) for k in range(1, 11))
CLEAN = "reconstruction"
STRENGTHS = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Severities of the degradations of motion."""

PAPER_TRUTH, PAPER_CLEAN = 0.97, 0.91
PAPER_SCORES: dict[Corruption, tuple[float, ...]] = {
    "hierarchical": (0.88, 0.84, 0.79, 0.75, 0.70, 0.64, 0.57, 0.52, 0.46, 0.40),
    "uniform": (0.76, 0.58, 0.36, 0.30, 0.24, 0.18, 0.12, 0.06, 0.02, 0.00),
}
PAPER_FID: dict[Corruption, tuple[float, ...]] = {
    "hierarchical": (1.69, 2.09, 2.48, 3.23, 4.06, 4.64, 5.57, 6.83, 7.67, 8.75),
    "uniform": (2.74, 5.56, 9.40, 13.63, 18.00, 21.56, 25.23, 27.62, 29.43, 30.15),
}
PAPER_CLEAN_FID = 1.36


def level_name(kind: Corruption, rate: float) -> str:
    """`uniform 0.3`, the name of a level in tables and files."""
    return f"{kind} {rate:.1f}"


def paper_scores() -> dict[str, float]:
    """The paper's table by level, without its score for motion that was never tokenised (0.97)."""
    table = {CLEAN: PAPER_CLEAN}
    for kind in get_args(Corruption):
        table |= {level_name(kind, r): s for r, s in zip(RATES, PAPER_SCORES[kind], strict=True)}
    return table


def scores_from_fid(fid: Mapping[str, float]) -> dict[str, float]:
    """Scores of levels from their FID, along the paper's curve of score over FID; both scaled to their largest FID.

    The curve is first made monotone, because the paper's two kinds of corruption do not lie on one curve (score 0.75 at
    FID 3.23, but 0.76 at 2.74 and 0.58 at 5.56).
    """
    points = [(0.0, PAPER_TRUTH), (PAPER_CLEAN_FID, PAPER_CLEAN)]
    for kind in get_args(Corruption):
        points += list(zip(PAPER_FID[kind], PAPER_SCORES[kind], strict=True))
    points.sort()
    at = np.array([point[0] for point in points]) / PAPER_FID["uniform"][-1]
    score = np.minimum.accumulate([point[1] for point in points])
    curve, most = PchipInterpolator(at, score), max(fid.values())
    return {name: float(np.clip(curve(value / most), 0, 1)) for name, value in fid.items()}


def degraded(
    features: Float[Tensor, "b t c"], kind: Degradation, strength: float, skeleton: Skeleton
) -> Float[Tensor, "b t c"]:
    """Degraded features; `strength` runs from 0 to 1.

    jitter: noise on every rotation, 0.1 (about 6 degrees) at full strength. time_warp: time runs fast and slow.
    foot_slide: the root drifts, up to 1 m/s. frozen_limbs: that share of the joints stops moving.
    """
    random = torch.Generator().manual_seed(0)
    made, travel = features.clone(), travel_slice(skeleton)
    rows, frames, channels = features.shape
    match kind:
        case "jitter":
            noise = 0.1 * strength * torch.randn(features.shape, generator=random)
            noise[..., travel] = 0
            return made + noise
        case "time_warp":
            phase = torch.arange(frames) / 15 * torch.pi
            at = (torch.arange(frames) + strength * 6 * phase.sin()).round().long().clamp(0, frames - 1)
            return made[:, at]
        case "foot_slide":
            way = torch.randn(rows, 1, 2, generator=random)
            made[..., travel.start : travel.start + 2] += strength / 30 * way / way.norm(dim=-1, keepdim=True)
            return made
        case "frozen_limbs":
            ends = [k for k in range(channels) if not travel.start <= k < travel.stop]
            limbs = torch.tensor(ends).view(-1, 6)
            count = round(strength * len(limbs))
            for row in range(rows):
                stopped = limbs[torch.randperm(len(limbs), generator=random)[:count]].flatten()
                made[row, :, stopped] = features[row, :1, stopped]
            return made


def read_scores(path: Path) -> dict[str, float]:
    """Scores by level from a file of `echoavatar align calibrate`.

    Raises CheckpointError if the file is missing or holds something else.
    """
    try:
        scores = {str(name): float(score) for name, score in read_object_file(path)["scores"].items()}
    except (OSError, EchoAvatarError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f"{path} holds no scores ({error}); make it with `echoavatar align calibrate`") from error
    missing = [name for name in paper_scores() if name not in scores]
    if missing:
        raise CheckpointError(f"{path} lacks the score of {missing[0]!r}; make it with `echoavatar align calibrate`")
    return scores
