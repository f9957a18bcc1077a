"""Scores of generated fingers against held-out truth, with the mean pose and flat hands as baselines.

The mean pose has low errors, so there are also scores of liveliness (speed, spread), of agreement over time
(correlation of curl) and of the distance between the sets of poses (Frechet).
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.models.fingers.clips import FINGERS, FingerClip, HandBasis, finger_rotations, hand_poses
from echoavatar.models.fingers.model import STEPS, FingerModel, sample_hands
from echoavatar.models.fingers.refine import smoothed
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import angle_between
from echoavatar.timing import FRAME_RATE_HZ

from .metrics.distributions import frechet_distance

_TIPS = {HUMANOID.index(name): tip for name, tip in HUMANOID.config.tips.items() if HUMANOID.index(name) in FINGERS}
_HANDS = HUMANOID.indices(("leftHand", "rightHand"))


def measure_fingers(model: FingerModel, clips: Sequence[FingerClip]) -> dict[str, dict[str, float]]:
    """Scores on held-out clips of the model, of the model in one step, of the mean pose and of flat hands.

    Both hands are generated from the body alone. `truth` holds the liveliness of the true fingers.
    """
    moving = [clip for clip in clips if bool(clip.is_moving.all())]
    if not moving:
        raise ValueError("no clip whose fingers move on both hands")
    made: dict[str, list[Tensor]] = {"model": [], "model, one step": [], "mean pose": [], "flat hands": []}
    truths = [finger_rotations(clip.hands) for clip in moving]
    flat = torch.eye(3).expand(1, len(FINGERS), 3, 3)
    for clip, truth in zip(moving, truths, strict=True):
        for name, count in (("model", STEPS), ("model, one step", 1)):
            none = torch.zeros(len(clip.body), 2, dtype=torch.bool)
            blank = torch.zeros(len(clip.body), 2, model.config.poses)
            hands = sample_hands(model, clip.body, blank, none, seed=0, steps=count)
            made[name].append(finger_rotations(smoothed(model.basis.decode(hands).numpy())))
        made["mean pose"].append(finger_rotations(model.hand_mean.expand(1, 2, -1)).expand_as(truth))
        made["flat hands"].append(flat.expand_as(truth))
    scores = {name: compare(guesses, truths, model.basis) for name, guesses in made.items()}
    own = speed_and_spread(truths)
    return scores | {"truth": {key: round(value, 3) for key, value in own.items()}}


def compare(
    guesses: Sequence[Float[Tensor, "t 30 3 3"]], truths: Sequence[Float[Tensor, "t 30 3 3"]], basis: HandBasis
) -> dict[str, float]:
    """Scores of guesses against truths, pair by pair; names contain the units."""
    guess, truth = torch.cat(list(guesses)), torch.cat(list(truths))
    error = torch.rad2deg(angle_between(guess, truth)).mean()
    tips = (fingertips(guess) - fingertips(truth)).norm(dim=-1).mean()
    numbers = {
        "error_deg": float(error),
        "tip_error_cm": 100 * float(tips),
        "curl_correlation": _correlation(curl(guess), curl(truth)),
        "frechet": frechet_distance(_plain(basis, guess), _plain(basis, truth)),
    }
    return {key: round(value, 3) for key, value in (numbers | speed_and_spread(guesses)).items()}


def speed_and_spread(clips: Sequence[Float[Tensor, "t 30 3 3"]]) -> dict[str, float]:
    """Speed of the fingers and spread of their poses."""
    speeds = torch.cat([torch.rad2deg(angle_between(clip[:-1], clip[1:])).flatten() for clip in clips])
    fingers = torch.cat(list(clips))
    mean = finger_rotations(hand_poses(fingers).mean(0))
    spread = torch.rad2deg(angle_between(fingers, mean.expand_as(fingers))).square().mean().sqrt()
    numbers = speeds.numpy() * FRAME_RATE_HZ
    return {
        "speed_mean_deg_s": float(numbers.mean()),
        "speed_p95_deg_s": float(np.percentile(numbers, 95)),
        "spread_deg": float(spread),
    }


def fingertips(fingers: Float[Tensor, "t 30 3 3"]) -> Float[Tensor, "t 10 3"]:
    """Positions of the fingertips, thumb to little finger, left then right, relative to their hand, metres."""
    rotations = torch.eye(3).expand(len(fingers), HUMANOID.joints, 3, 3).clone()
    rotations[:, list(FINGERS)] = fingers
    pose = forward_kinematics(HUMANOID, rotations, torch.zeros(len(fingers), 3))
    joints = sorted(_TIPS)
    ends = torch.tensor([_TIPS[joint] for joint in joints])[..., None]
    places = pose.positions[:, joints] + (pose.rotations[:, joints] @ ends).squeeze(-1)
    return places - pose.positions[:, _HANDS].repeat_interleave(len(joints) // 2, 1)


def curl(fingers: Float[Tensor, "t 30 3 3"]) -> Float[Tensor, "t 2"]:
    """How far each hand is closed: mean distance of its fingertips from those of the flat hand, metres."""
    flat = fingertips(torch.eye(3).expand(1, len(FINGERS), 3, 3))
    gone = (fingertips(fingers) - flat).norm(dim=-1).reshape(-1, 2, 5)
    closed: Tensor = gone[..., 1:].mean(-1)
    return closed


def _correlation(a: Float[Tensor, "t 2"], b: Float[Tensor, "t 2"]) -> float:
    """Pearson correlation, mean of both hands; 0 if a curve is constant."""
    a, b = a - a.mean(0), b - b.mean(0)
    size = a.norm(dim=0) * b.norm(dim=0)
    return float(torch.where(size > 1e-6, (a * b).sum(0) / size.clamp_min(1e-6), 0.0).mean())


def _plain(basis: HandBasis, fingers: Tensor) -> Float[np.ndarray, "n k"]:
    """Coordinates of every hand, not whitened (in units of 6D)."""
    coordinates = (basis.encode(hand_poses(fingers)) * basis.scale).flatten(0, 1)
    return np.asarray(coordinates.double().numpy())
