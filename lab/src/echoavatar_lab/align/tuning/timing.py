"""Do many bodies at once brake on beats and end strokes on stresses? `beat_alignment` and `stress_alignment` of
`echoavatar_lab.align.rewards`, in torch.

Peaks are at least three frames apart. Of two that are closer the higher one counts; scipy, which the rewards use,
decides among more than two by turns, so that rare rows differ in one peak.
"""

from functools import cache

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.evaluation.metrics.beat_alignment import ARM_JOINTS, SHARP_SIGMA_S, SMOOTHING_FRAMES, STROKE_DELAY_S

APART = 3  # frames between peaks
FAR_S = 1e3  # further than any event


def smoothed(x: Float[Tensor, "r t *c"], sigma: float, mode: str = "reflect") -> Float[Tensor, "r t *c"]:
    """The Gaussian filter of scipy filter along time (`sigma` in frames), as a product with one matrix."""
    matrix = torch.as_tensor(_gaussian(x.shape[1], sigma, mode), dtype=x.dtype, device=x.device)
    return (matrix @ x.flatten(2)).view(x.shape)


@cache
def _gaussian(frames: int, sigma: float, mode: str) -> Float[np.ndarray, "t t"]:
    return np.asarray(gaussian_filter1d(np.eye(frames), sigma, axis=0, mode=mode))


def timing(
    skeleton: Skeleton,
    positions: Float[Tensor, "r t j 3"],
    lead: int,
    beats: Float[Tensor, "r e"],
    stresses: Float[Tensor, "r e"],
) -> tuple[Float[Tensor, "r n"], Float[Tensor, "r n"]]:
    """Excess over chance on beats and on stresses, by new frame; each row's sum is its score.

    Events are seconds from the first new frame, NaN where a row has fewer than others.
    """
    still = smoothed(positions, SMOOTHING_FRAMES, "nearest")
    speed = (still[:, 1:] - still[:, :-1]).norm(dim=-1) * FRAME_RATE_HZ
    whole = speed.mean(2)
    frames = positions.shape[1] - lead
    braking = whole[:, :-1] - whole[:, 1:]
    on_beats = _hits(_peaks(braking, torch.zeros_like(braking[:, :1])), 1.0 - lead, frames, beats)
    late = stresses + STROKE_DELAY_S
    arms = [speed[:, :, joint] for joint in skeleton.indices(ARM_JOINTS)]
    rests = [_hits(_peaks(-arm, -arm.mean(1, keepdim=True)), 0.5 - lead, frames, late) for arm in arms]
    on_stresses = tuple(torch.stack(part).mean(0) for part in zip(*rests, strict=True))
    return _excess(*on_beats, beats), _excess(on_stresses[0], on_stresses[1], late)


def _peaks(x: Float[Tensor, "r t"], lowest: Float[Tensor, "r 1"]) -> Bool[Tensor, "r t"]:
    """Local maxima that are at least `lowest` and the highest within `APART` frames."""
    inner = (x[:, 1:-1] > x[:, :-2]) & (x[:, 1:-1] > x[:, 2:])
    is_peak = F.pad(inner, (1, 1)) & (x >= lowest)
    height = torch.where(is_peak, x, -torch.inf)
    return is_peak & (height >= F.max_pool1d(height[:, None], 2 * APART - 1, 1, APART - 1)[:, 0])


def _hits(
    is_peak: Bool[Tensor, "r t"], offset: float, frames: int, events: Float[Tensor, "r e"]
) -> tuple[Float[Tensor, "r e"], Float[Tensor, "r n"]]:
    """Hits of the events and of each new frame by the nearest peak; peak k is at frame k + `offset`."""
    at = (torch.arange(is_peak.shape[1], device=is_peak.device) + offset) / FRAME_RATE_HZ
    frame = torch.arange(frames, device=is_peak.device) / FRAME_RATE_HZ

    def hit(times: Float[Tensor, "r m"]) -> Float[Tensor, "r m"]:
        apart = torch.where(is_peak[:, None], (times[:, :, None] - at).abs(), FAR_S).amin(2)
        return torch.exp(-(apart**2) / (2 * SHARP_SIGMA_S**2))

    return hit(torch.nan_to_num(events, nan=-FAR_S)), hit(frame.expand(len(is_peak), -1))


def _excess(
    hit: Float[Tensor, "r e"], anywhere: Float[Tensor, "r n"], events: Float[Tensor, "r e"]
) -> Float[Tensor, "r n"]:
    """By frame: the hit of each event, minus the mean hit of an event anywhere between the first and the last."""
    frames = anywhere.shape[1]
    frame = torch.arange(frames, device=hit.device) / FRAME_RATE_HZ
    is_event = events < frames / FRAME_RATE_HZ  # and not NaN
    count = is_event.sum(1, keepdim=True)
    at = torch.where(is_event, events * FRAME_RATE_HZ, 0.0).long().clamp(0, frames - 1)
    out = torch.zeros_like(anywhere).scatter_add(1, at, torch.where(is_event, hit, 0.0) / count.clamp(min=1))
    first = torch.where(is_event, events, torch.inf).amin(1, keepdim=True)
    last = torch.where(is_event, events, -torch.inf).amax(1, keepdim=True)
    between = ((frame >= first) & (frame <= last)).float()
    chance = anywhere * between / between.sum(1, keepdim=True).clamp(min=1)
    return (out - chance) * (count >= 2)
