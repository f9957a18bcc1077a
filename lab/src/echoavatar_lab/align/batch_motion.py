"""Measures the motion of many continuations at once, all in torch, on a GPU or not.

Timing is `beat_alignment` and `stress_alignment` of `rewards`: do bodies brake on beats and end strokes on stresses?
Peaks are at least three frames apart, and of two that are closer the higher one counts; scipy, which the rewards use,
decides among more than two by turns, so that rare rows differ in one peak. `liveliness` is the nine statistics of
`evaluation.metrics.liveliness`.
"""

import math
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
from echoavatar_lab.evaluation.metrics.liveliness import APART_S, AT_WORK, CUBE, HEAD_OVER_ANKLE_M, POINTS, STILL

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


LOWEST_HEAD_M = 0.2  # a body whose head is lower than this above its ankles does not stand
PATH_STEP, PATH_HZ = 3, 10  # frames from one point of a hand's path to the next; points a second
CUBES = 128  # along an axis; a hand stays well within them


def of_common_height(points: Float[Tensor, "r t 12 3"]) -> tuple[Float[Tensor, "r t 12 3"], Bool[Tensor, " r"]]:
    """The points of `POINTS` of bodies of one height, and which bodies stand."""
    ankles = points[:, :, [POINTS.index("leftFoot"), POINTS.index("rightFoot")], 1].amin(2)
    height = (points[:, :, POINTS.index("head"), 1] - ankles).median(1).values
    scale = HEAD_OVER_ANKLE_M / height.clamp(min=LOWEST_HEAD_M)
    return points * scale[:, None, None, None], height > LOWEST_HEAD_M


def liveliness(points: Float[Tensor, "r t 12 3"]) -> Float[Tensor, "r 9"]:
    """A row for each body, in the order of `STATISTICS`."""
    left, right = _at(points, "leftUpperArm"), _at(points, "rightUpperArm")
    hands = _hands(points)
    speeds = _speed(hands)
    hips = _at(points, "leftUpperLeg") - _at(points, "rightUpperLeg")
    turn = _unwrapped(_yaw(left - right) - _yaw(hips))
    trunk = (left + right) / 2 - _at(points, "hips")
    lean = torch.atan2(trunk[..., 2], trunk[..., 1])
    side = _at(points, "hips")[..., 0]
    columns = (
        speeds.mean((1, 2)),
        (speeds < STILL).all(2).float().mean(1),
        (speeds > AT_WORK).all(2).float().mean(1),
        _room(hands),
        _novelty(hands),
        torch.rad2deg(turn.std(1, correction=0)),
        torch.rad2deg(lean.std(1, correction=0)),
        100 * (side - smoothed(side[..., None], 4 * FRAME_RATE_HZ)[..., 0]).std(1, correction=0),
        _speed(points[:, :, [POINTS.index("leftFoot"), POINTS.index("rightFoot")]]).mean((1, 2)),
    )
    return torch.stack(columns, 1)


def hands_still(points: Float[Tensor, "r t 12 3"]) -> Bool[Tensor, "r t"]:
    """In which frames both hands are still; the first frame is as the second."""
    still = (_speed(_hands(points)) < STILL).all(2)
    return torch.cat([still[:, :1], still], 1)


def _hands(points: Float[Tensor, "r t 12 3"]) -> Float[Tensor, "r t 2 3"]:
    """Both wrists in the shoulders' frame, arm lengths."""
    left, right = _at(points, "leftUpperArm"), _at(points, "rightUpperArm")
    elbow, wrist = _at(points, "leftLowerArm"), _at(points, "leftHand")
    arm = ((left - elbow).norm(dim=-1) + (elbow - wrist).norm(dim=-1)).median(1).values
    hands = points[:, :, [POINTS.index("leftHand"), POINTS.index("rightHand")]]
    x, y, z = ((hands - ((left + right) / 2)[:, :, None]) / arm[:, None, None, None]).unbind(-1)
    turn = _yaw(left - right)[..., None]
    return torch.stack([turn.cos() * x - turn.sin() * z, y, turn.sin() * x + turn.cos() * z], -1)


def _room(hands: Float[Tensor, "r t 2 3"]) -> Float[Tensor, " r"]:
    x, y, z = (torch.floor(hands / CUBE).long() + CUBES // 2).unbind(-1)
    cubes = ((x * CUBES + y) * CUBES + z).sort(1).values
    return ((cubes[:, 1:] != cubes[:, :-1]).sum(1) + 1).sum(1).float()


def _novelty(hands: Float[Tensor, "r t 2 3"]) -> Float[Tensor, " r"]:
    path = smoothed(hands.flatten(2), 2.0)[:, ::PATH_STEP]
    count = max(path.shape[1] - PATH_HZ, 1)
    seconds = path.unfold(1, PATH_HZ, 1)[:, :count].flatten(2)
    apart = torch.cdist(seconds, seconds, compute_mode="donot_use_mm_for_euclid_dist") / math.sqrt(seconds.shape[2])
    number = torch.arange(count, device=hands.device)
    is_far = (number[:, None] - number).abs() > APART_S * PATH_HZ
    return torch.where(is_far, apart, torch.inf).amin(2).mean(1)


def _speed(paths: Float[Tensor, "r t k 3"]) -> Float[Tensor, "r s k"]:
    path = smoothed(paths, 1.0)
    speed: Tensor = torch.diff(path, dim=1).norm(dim=-1) * FRAME_RATE_HZ
    return speed


def _at(points: Float[Tensor, "r t 12 3"], name: str) -> Float[Tensor, "r t 3"]:
    return points[:, :, POINTS.index(name)]


def _yaw(across: Float[Tensor, "r t 3"]) -> Float[Tensor, "r t"]:
    return torch.atan2(-across[..., 2], across[..., 0])


def _unwrapped(angle: Float[Tensor, "r t"]) -> Float[Tensor, "r t"]:
    step = torch.remainder(angle[:, 1:] - angle[:, :-1] + math.pi, 2 * math.pi) - math.pi
    return torch.cat([angle[:, :1], angle[:, :1] + step.cumsum(1)], 1)
