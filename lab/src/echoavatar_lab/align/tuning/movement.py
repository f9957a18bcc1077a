"""The nine statistics of `evaluation.metrics.liveliness` for many bodies at once, in torch."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.evaluation.metrics.liveliness import (
    APART_S,
    AT_WORK,
    CUBE,
    HEAD_OVER_ANKLE_M,
    POINTS,
    STATISTICS,
    STILL,
)

from .timing import smoothed

LOWEST_HEAD_M = 0.2  # a body whose head is lower than this above its ankles does not stand
PATH_STEP, PATH_HZ = 3, 10  # frames from one point of a hand's path to the next; points a second
CUBES = 128  # along an axis; a hand stays well within them
NAMES = tuple(STATISTICS)


def of_common_height(points: Float[Tensor, "r t 12 3"]) -> tuple[Float[Tensor, "r t 12 3"], Bool[Tensor, " r"]]:
    """The points of `POINTS` of bodies of one height, and which bodies stand."""
    ankles = points[:, :, [POINTS.index("leftFoot"), POINTS.index("rightFoot")], 1].amin(2)
    height = (points[:, :, POINTS.index("head"), 1] - ankles).median(1).values
    scale = HEAD_OVER_ANKLE_M / height.clamp(min=LOWEST_HEAD_M)
    return points * scale[:, None, None, None], height > LOWEST_HEAD_M


def liveliness(points: Float[Tensor, "r t 12 3"]) -> Float[Tensor, "r 9"]:
    """A row for each body, in the order of `NAMES`."""
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
