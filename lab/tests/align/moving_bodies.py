"""Scenes made by hand: bodies whose arms (and so the mean of the body) move as told."""

import numpy as np

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.decoded_motion import DecodedMotion
from echoavatar_lab.align.rewards import ReferenceStatistics

FRAMES, LEAD = 72, 8


def scene(
    speed: np.ndarray, *, beats=(), stresses=(), domain: int = 2, lead: int = LEAD, jitter: float = 0.0
) -> DecodedMotion:
    """All joints but the hips circle at `speed` (m/s, one a frame, the lead included)."""
    angle = np.cumsum(speed) / 30 / 0.2  # on a circle of 20 cm
    around = 0.2 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    positions = HUMANOID.rest_positions[None] + around[:, None]
    positions[:, 0] = HUMANOID.rest_positions[0]
    if jitter:
        positions = positions + jitter * np.random.default_rng(0).standard_normal(positions.shape)
    frames = len(speed)
    return DecodedMotion(
        HUMANOID, np.zeros((frames, 315), np.float32), positions, lead, np.full(frames, domain),
        np.asarray(beats, float), np.asarray(stresses, float),
        np.zeros((0, 2), np.int64), np.zeros((0, 3, 1), np.int64),
    )  # fmt: skip


def dips(events, *, frames: int = FRAMES, lead: int = LEAD, depth: float = 0.8, level: float = 0.5) -> np.ndarray:
    """A speed that dips at the events (seconds from the first new frame)."""
    time = (np.arange(frames + lead) - lead) / 30
    dip = sum((np.exp(-((time - event) ** 2) / (2 * 0.08**2)) for event in events), np.zeros(frames + lead))
    return level * (1 - depth * np.minimum(dip, 1))


def reference_statistics(**changes) -> ReferenceStatistics:
    """A body that moves most in music."""
    movement = ((0.01, 0.01, 0.01, 0.01), (0.1, 0.05, 0.05, 0.2), (0.2, 0.1, 0.2, 0.5))
    known = {"speed": (0.05, 0.3, 0.5), "movement": movement, "jerk": 100.0, "scenes": 10}
    return ReferenceStatistics.model_validate(known | changes)


def reach(made: DecodedMotion, own: ReferenceStatistics) -> float:
    """A reward of one's own, by name: height of the left hand."""
    return float(made.positions[:, made.skeleton.index("leftHand"), 1].mean())
