"""Scores of generated fingers against held-out truth, with the mean pose and flat hands as baselines.

The mean pose has low errors, so there are also scores of liveliness (speed, spread), of agreement over time
(correlation of curl) and of the distance between the sets of poses (Frechet).
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import angle_between
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.models.fingers.clips import FINGERS, FingerClip, HandBasis, finger_rotations, hand_poses
from echoavatar_lab.models.fingers.model import STEPS, FingerModel, sample_hands
from echoavatar_lab.models.fingers.refine import smoothed

from .metrics.distributions import frechet_distance

Array = np.ndarray
_TIPS = {HUMANOID.index(name): tip for name, tip in HUMANOID.config.tips.items() if HUMANOID.index(name) in FINGERS}
_HANDS = HUMANOID.indices(("leftHand", "rightHand"))


def measure_fingers(model: FingerModel, clips: Sequence[FingerClip]) -> dict[str, dict[str, float]]:
    """Scores on held-out clips of the model, of the model in one step, of the mean pose and of flat hands.

    Both hands are generated from the body alone. `truth` holds the liveliness of the true fingers.
    """
    moving = [clip for clip in clips if bool(clip.is_moving.all())]
    if not moving:
        raise ValueError("no clip whose fingers move on both hands")
    made: dict[str, list[Array]] = {"model": [], "model, one step": [], "mean pose": [], "flat hands": []}
    truths = [finger_rotations(clip.hands.numpy()) for clip in moving]
    mean = finger_rotations(model.hand_mean.expand(1, 2, -1).numpy())
    for clip, truth in zip(moving, truths, strict=True):
        for name, count in (("model", STEPS), ("model, one step", 1)):
            none = torch.zeros(len(clip.body), 2, dtype=torch.bool)
            blank = torch.zeros(len(clip.body), 2, model.config.poses)
            hands = sample_hands(model, clip.body, blank, none, seed=0, steps=count)
            made[name].append(finger_rotations(smoothed(model.basis.decode(hands).numpy())))
        made["mean pose"].append(np.broadcast_to(mean, truth.shape))
        made["flat hands"].append(np.broadcast_to(np.eye(3, dtype=np.float32), truth.shape))
    scores = {name: compare(guesses, truths, model.basis) for name, guesses in made.items()}
    own = speed_and_spread(truths)
    return scores | {"truth": {key: round(value, 3) for key, value in own.items()}}


def compare(
    guesses: Sequence[Float[Array, "t 30 3 3"]], truths: Sequence[Float[Array, "t 30 3 3"]], basis: HandBasis
) -> dict[str, float]:
    """Scores of guesses against truths, pair by pair; names contain the units."""
    guess, truth = np.concatenate(guesses), np.concatenate(truths)
    error = np.degrees(angle_between(guess, truth)).mean()
    tips = np.linalg.norm(fingertips(guess) - fingertips(truth), axis=-1).mean()
    numbers = {
        "error_deg": float(error),
        "tip_error_cm": 100 * float(tips),
        "curl_correlation": _correlation(curl(guess), curl(truth)),
        "frechet": frechet_distance(_plain(basis, guess), _plain(basis, truth)),
    }
    return {key: round(value, 3) for key, value in (numbers | speed_and_spread(guesses)).items()}


def speed_and_spread(clips: Sequence[Float[Array, "t 30 3 3"]]) -> dict[str, float]:
    """Speed of the fingers and spread of their poses."""
    speeds = [np.degrees(angle_between(clip[:-1], clip[1:])).ravel() for clip in clips]
    fingers, numbers = np.concatenate(clips), np.concatenate(speeds) * FRAME_RATE_HZ
    mean = finger_rotations(hand_poses(fingers).mean(0))
    spread = np.sqrt(np.square(np.degrees(angle_between(fingers, mean))).mean())
    return {
        "speed_mean_deg_s": float(numbers.mean()),
        "speed_p95_deg_s": float(np.percentile(numbers, 95)),
        "spread_deg": float(spread),
    }


def fingertips(fingers: Float[Array, "t 30 3 3"]) -> Float[Array, "t 10 3"]:
    """Positions of the fingertips, thumb to little finger, left then right, relative to their hand, metres."""
    rotations = np.tile(np.eye(3, dtype=np.float32), (len(fingers), HUMANOID.joints, 1, 1))
    rotations[:, list(FINGERS)] = fingers
    pose = forward_kinematics(HUMANOID, rotations, np.zeros((len(fingers), 3), np.float32))
    joints = sorted(_TIPS)
    ends = np.array([_TIPS[joint] for joint in joints], np.float32)[..., None]
    places = pose.positions[:, joints] + (pose.rotations[:, joints] @ ends)[..., 0]
    tips: Array = places - np.repeat(pose.positions[:, _HANDS], len(joints) // 2, 1)
    return tips


def curl(fingers: Float[Array, "t 30 3 3"]) -> Float[Array, "t 2"]:
    """How far each hand is closed: mean distance of its fingertips from those of the flat hand, metres."""
    flat = fingertips(np.tile(np.eye(3, dtype=np.float32), (1, len(FINGERS), 1, 1)))
    gone = np.linalg.norm(fingertips(fingers) - flat, axis=-1).reshape(-1, 2, 5)
    closed: Array = gone[..., 1:].mean(-1)
    return closed


def _correlation(a: Float[Array, "t 2"], b: Float[Array, "t 2"]) -> float:
    """Pearson correlation, mean of both hands; 0 if a curve is constant."""
    a, b = a - a.mean(0), b - b.mean(0)
    size = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    return float(np.where(size > 1e-6, (a * b).sum(0) / np.maximum(size, 1e-6), 0.0).mean())


def _plain(basis: HandBasis, fingers: Array) -> Float[np.ndarray, "n k"]:
    """Coordinates of every hand, not whitened (in units of 6D)."""
    coordinates = (basis.encode(torch.from_numpy(hand_poses(fingers))) * basis.scale).flatten(0, 1)
    return np.asarray(coordinates.double().numpy())
