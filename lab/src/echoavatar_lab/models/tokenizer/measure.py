"""Reconstruction error of a tokenizer (paper, table on the tokenizer): MPJPE, root velocity error, codebook use.

Positions are character-centric: the root stands above the origin; heading is kept, so errors of heading count too.
Fingers are measured from their wrist.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.models.codebook_training import steady_codes
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .losses import PlaneKinematics, finger_joints, wrist_of


class CodeUsage(NamedTuple):
    """Per layer: share of the codes that occur, and perplexity (the equivalent number of even codes)."""

    fraction: Float[Tensor, " q"]
    perplexity: Float[Tensor, " q"]


def code_usage(codes: Int[Tensor, "*n q"], size: int) -> CodeUsage:
    """Statistics of codes 0..size-1; negative ones (layers not sent) do not count."""
    layers = codes.reshape(-1, codes.shape[-1]).unbind(-1)
    counts = torch.stack([torch.bincount(layer[layer >= 0], minlength=size) for layer in layers]).double()
    share = counts / counts.sum(-1, keepdim=True).clamp_min(1)
    entropy = -(share * share.clamp_min(1e-12).log()).sum(-1)
    return CodeUsage((counts > 0).double().mean(-1).float(), entropy.exp().float())


MILLIMETRES = 1000.0


class TokenizerScores(NamedTuple):
    """Means over frames and joints; use and perplexity are lists over layers for each part."""

    mpjpe_body_mm: float
    mpjpe_hands_mm: float
    root_velocity_mm: float
    skate_cm_s: float
    usage: dict[str, list[float]]
    perplexity: dict[str, list[float]]


@torch.no_grad()
def measure(tokenizer: BodyTokenizer, clips: Sequence[Float[Tensor, "_ c"]], patience: float = 0.0) -> TokenizerScores:
    """Encode (with `patience`, see `steady_codes`) and decode every clip as a stream and compare."""
    was_training = tokenizer.training
    tokenizer.eval()
    kinematics = PlaneKinematics(tokenizer.skeleton).to(tokenizer.mean.device)
    rows, codes = [], []
    for clip in clips:
        whole = clip[: len(clip) - len(clip) % FRAMES_PER_MOTION_TOKEN][None].to(tokenizer.mean)
        chosen = steady_codes(tokenizer, whole, patience)
        rows.append(_errors(tokenizer.skeleton, kinematics, tokenizer.decode(chosen), whole))
        codes.append(chosen[0])
    tokenizer.train(was_training)
    errors = torch.cat(rows, 1)
    every = torch.cat(codes)
    usage = {name: code_usage(every[:, p], tokenizer.config.codes) for p, name in enumerate(tokenizer.parts)}
    body, hands, velocity, slip, planted = errors.sum(1).tolist()
    frames = errors.shape[1]
    return TokenizerScores(
        body / frames,
        hands / frames,
        velocity / frames,
        slip / max(planted, 1) * 30 / 10,
        {name: [round(x, 3) for x in value.fraction.tolist()] for name, value in usage.items()},
        {name: [round(x, 1) for x in value.perplexity.tolist()] for name, value in usage.items()},
    )


def _errors(skeleton: Skeleton, kinematics: PlaneKinematics, decoded: Tensor, truth: Tensor) -> Tensor:
    """(5, t): body, hands, root velocity errors in mm; slip of planted feet in mm per frame; planted feet."""
    ours, theirs = (kinematics(x)[:, :, 0] * MILLIMETRES for x in (decoded, truth))
    hands = finger_joints(skeleton)
    body = [joint for joint in skeleton.feature_joints if joint not in hands]
    wrists = [wrist_of(skeleton, joint) for joint in hands]
    difference = ours - theirs
    start = travel_slice(skeleton).start
    moved, wanted = (x[0, :, start : start + 2].T * MILLIMETRES for x in (decoded, truth))
    feet, ground = list(skeleton.config.feet), [0, 2]
    steps = [
        torch.nn.functional.pad(x[ground][:, feet].diff(dim=-1), (1, 0)) + v[:, None]
        for x, v in ((ours, moved), (theirs, wanted))
    ]
    is_planted = (steps[1].norm(dim=0) < 1.0).float()
    return torch.stack(
        [
            difference[:, body].norm(dim=0).mean(0),
            (difference[:, hands] - difference[:, wrists]).norm(dim=0).mean(0),
            (moved - wanted).norm(dim=0),
            (steps[0].norm(dim=0) * is_planted).sum(0),
            is_planted.sum(0),
        ]
    )
