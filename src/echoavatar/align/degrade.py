"""Motion made worse by known amounts: the curriculum of the quality reward (paper, Corruption-based Quality Ordering).

Two kinds act on codes and are trained on; four act on motion and test whether the reward generalises, unless they are
trained on as well (`spoiled_scores`). Scores are the paper's table, or one's own by FID (`scores_from_fid`).
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from ..errors import CheckpointError
from ..kinematics import Skeleton
from ..kinematics.features import travel_slice
from ..tokens import corrupt_hierarchically, corrupt_uniformly

Kind = Literal["hierarchical", "uniform"]
Unseen = Literal["jitter", "time_warp", "foot_slide", "frozen_limbs"]
RATES = tuple(round(0.1 * k, 1) for k in range(1, 11))
CLEAN = "reconstruction"
STRENGTHS = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Severities of the kinds that act on motion."""

PAPER_TRUTH, PAPER_CLEAN = 0.97, 0.91
PAPER_SCORES: dict[Kind, tuple[float, ...]] = {
    "hierarchical": (0.88, 0.84, 0.79, 0.75, 0.70, 0.64, 0.57, 0.52, 0.46, 0.40),
    "uniform": (0.76, 0.58, 0.36, 0.30, 0.24, 0.18, 0.12, 0.06, 0.02, 0.00),
}
PAPER_FID: dict[Kind, tuple[float, ...]] = {
    "hierarchical": (1.69, 2.09, 2.48, 3.23, 4.06, 4.64, 5.57, 6.83, 7.67, 8.75),
    "uniform": (2.74, 5.56, 9.40, 13.63, 18.00, 21.56, 25.23, 27.62, 29.43, 30.15),
}
PAPER_CLEAN_FID = 1.36


def level_name(kind: Kind | Unseen, rate: float) -> str:
    """`uniform 0.3`, the key of a level in tables and files."""
    return f"{kind} {rate:.1f}"


def paper_scores() -> dict[str, float]:
    """The paper's table by level; its ground truth (0.97) needs motion that was never tokenised."""
    table = {CLEAN: PAPER_CLEAN}
    for kind in get_args(Kind):
        table |= {level_name(kind, r): s for r, s in zip(RATES, PAPER_SCORES[kind], strict=True)}
    return table


def spoiled_scores(kinds: Sequence[Unseen]) -> dict[str, float]:
    """Scores of motion made worse by hand: by severity from the clean score down to the worst hierarchical one's.

    Ours: FID hardly sees frozen limbs or warped time, so these scores are set, not measured.
    """
    worst = PAPER_SCORES["hierarchical"][-1]
    return {
        level_name(kind, s): PAPER_CLEAN + (worst - PAPER_CLEAN) * s for kind in kinds for s in STRENGTHS if s
    }


def scores_from_fid(fid: Mapping[str, float]) -> dict[str, float]:
    """Scores of levels by their own FID: the paper's curve of score over FID, both scaled to their largest FID.

    The curve is made monotone first, since the paper's scores are not quite a function of its FIDs (0.75 at 3.23, 0.76
    at 2.74 and 0.58 at 5.56 belong to different kinds).
    """
    points = [(0.0, PAPER_TRUTH), (PAPER_CLEAN_FID, PAPER_CLEAN)]
    for kind in get_args(Kind):
        points += list(zip(PAPER_FID[kind], PAPER_SCORES[kind], strict=True))
    points.sort()
    at = np.array([point[0] for point in points]) / PAPER_FID["uniform"][-1]
    score = np.minimum.accumulate([point[1] for point in points])
    curve, most = PchipInterpolator(at, score), max(fid.values())
    return {name: float(np.clip(curve(value / most), 0, 1)) for name, value in fid.items()}


def corrupted(
    codes: Int[Tensor, "b n p q"], kind: Kind, rate: float, *, codebook: int, generator: torch.Generator
) -> Int[Tensor, "b n p q"]:
    """Codes at one level."""
    act = corrupt_hierarchically if kind == "hierarchical" else corrupt_uniformly
    return act(codes, rate, codebook=codebook, generator=generator)


def spoiled(
    features: Float[Tensor, "b t c"], kind: Unseen, strength: float, skeleton: Skeleton, *, seed: int = 0
) -> Float[Tensor, "b t c"]:
    """Features made worse by a kind never trained on; `strength` 0 to 1.

    jitter: noise on every rotation, 0.1 (about 6 degrees) at full strength. time_warp: time runs fast and slow.
    foot_slide: the root drifts, up to 1 m/s. frozen_limbs: joints outside the trunk stop, that share of them.
    """
    random = torch.Generator().manual_seed(seed)
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
    """Scores by level that `echoavatar align calibrate` wrote.

    Raises:
        CheckpointError: the file is something else.
    """
    try:
        scores = {str(name): float(score) for name, score in json.loads(path.read_text())["scores"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(
            f"{path} holds no scores ({error}); make it with `echoavatar align calibrate`"
        ) from error
    missing = [name for name in paper_scores() if name not in scores]
    if missing:
        raise CheckpointError(
            f"{path} lacks the score of {missing[0]!r}; make it with `echoavatar align calibrate`"
        )
    return scores
