"""Measurements of single clips: of the motion alone, and of how the body behaves in each domain of sound."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Integer

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.foot_planting import planted
from echoavatar.motion.kinematics.rotations import angle_between
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize
from echoavatar_lab.data import SILENCE
from echoavatar_lab.data.faults import penetration_depth_m, skate

from .metrics.distributions import Moments, moments
from .metrics.liveliness import STATISTICS, body_points, liveliness, windows
from .metrics.motion_encoder import motion_features
from .metrics.positions import floor_depth_cm, foot_contact_score, jerk_m_s3, l1_deviation
from .table import weighted_mean

WINDOW_S = 30.0
SHORTEST_S = 10.0  # of a stretch of one kind of sound
SETTLE_FRAMES = 30  # frames at the start of a silence that do not count yet
LONG_SILENCE_FRAMES = 60
UNITS = {
    "l1_diversity": "m",
    "skate": "cm/s",
    "floor_depth": "cm",
    "hand_depth": "mm",
    "jerk": "m/s3",
    "foot_contact_score": "",
}
_BALLS = list(HUMANOID.config.feet)[1::2]  # the ankle may swing over a planted ball; the ball must not move
_STANDING = HUMANOID.rest_positions[_BALLS, 1]


@runtime_checkable
class Extractor(Protocol):
    """A feature extractor for FID."""

    def features(self, clip: Float[torch.Tensor, "t c"]) -> Float[torch.Tensor, "n d"]:
        """Latents of a clip of `motion_features`."""


@dataclass(frozen=True)
class ClipMeasurements:
    """Measurements of one clip that need no counterpart."""

    positions: Float[np.ndarray, "t j 3"]
    planted: float  # number of planted foot frames, the weight of the skate
    numbers: dict[str, float]  # by the names of `UNITS`
    latents: Moments | None


def measure_clip(motion: Motion, extractor: Extractor | None = None) -> ClipMeasurements:
    """Measure one clip on our rig at 30 fps."""
    positions = motion.pose().positions.astype(np.float64)
    balls = positions[:, _BALLS]
    above = balls - np.array([0.0, 1.0, 0.0]) * _STANDING[:, None]
    depth = penetration_depth_m(HUMANOID, motion.matrices())
    rotations, root = torch.from_numpy(motion.rotations), torch.from_numpy(motion.root)
    return ClipMeasurements(
        positions,
        float(planted(balls, FRAME_RATE_HZ, standing_height=_STANDING).sum()),
        {
            "l1_diversity": l1_deviation(positions - positions[:, :1]),
            "skate": skate(balls, FRAME_RATE_HZ, standing_height=_STANDING),
            "floor_depth": floor_depth_cm(above),
            "hand_depth": float(depth.mean() * 1000),
            "jerk": jerk_m_s3(positions),
            "foot_contact_score": foot_contact_score(positions, HUMANOID.config.feet),
        },
        latent_moments(extractor, rotations, root) if extractor else None,
    )


def latent_moments(
    extractor: Extractor, rotations: Float[torch.Tensor, "t j 4"], root: Float[torch.Tensor, "t 3"]
) -> Moments:
    """Moments of the extractor's latents of one clip."""
    return moments(extractor.features(motion_features(rotations, root)).numpy())


def clip_statistics(motion: Motion) -> list[float]:
    """Each statistic of `metrics.liveliness`: the mean over those windows of 30 s that have it."""
    rows = [liveliness(part, motion.fps) for part in windows(body_points(motion), motion.fps, WINDOW_S)]
    return [weighted_mean(np.array([row[name] for row in rows])) for name in STATISTICS]


@dataclass(frozen=True)
class Track:
    """Motion of one clip, and the domain of its audio."""

    positions: Float[np.ndarray, "t j 3"]
    angular_speed: Float[np.ndarray, "t-1 j"]  # degrees per second
    domain: Integer[np.ndarray, " t"]


def track(motion: Motion, domain: Integer[np.ndarray, " t"]) -> Track:
    """World positions and joint speeds of a clip at 30 fps."""
    matrices = motion.matrices()
    turn = np.degrees(angle_between(matrices[:-1], matrices[1:])) * FRAME_RATE_HZ
    return Track(motion.pose().positions, turn, domain)


def hand_speed_m_s(clip: Track, hands: Sequence[int]) -> Float[np.ndarray, " steps"]:
    """Mean speed of the wrists relative to the hips, per frame."""
    relative = clip.positions[:, list(hands)] - clip.positions[:, :1]
    return np.asarray(np.linalg.norm(np.diff(relative, axis=0), axis=-1).mean(1) * FRAME_RATE_HZ)


def leg_energy(clip: Track, legs: Sequence[int]) -> Float[np.ndarray, " steps"]:
    """Mean squared speed (m2/s2) of hips, knees, ankles and toes, per frame; travel and steps both count."""
    speed = np.linalg.norm(np.diff(clip.positions[:, list(legs)], axis=0), axis=-1) * FRAME_RATE_HZ
    return np.asarray((speed**2).mean(1))


def settled(domain: Integer[np.ndarray, " t"]) -> np.ndarray:
    """Marks frames of silence after its first second, in silences of at least two seconds."""
    quiet = np.zeros(len(domain), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], domain, [-1]])))
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        if domain[start] == SILENCE and end - start >= LONG_SILENCE_FRAMES:
            quiet[start + SETTLE_FRAMES : end] = True
    return quiet


def stretches(domain: Integer[np.ndarray, " t"], kind: int, shortest_s: float = SHORTEST_S) -> list[slice]:
    """Frames of one kind of sound, with the silences of up to two seconds between them, from `shortest_s` on."""
    own = np.flatnonzero(domain == kind)
    others = np.cumsum((domain != kind) & (domain != SILENCE))
    ends = np.flatnonzero((np.diff(own) > LONG_SILENCE_FRAMES) | (np.diff(others[own]) > 0)) + 1
    found = [slice(int(part[0]), int(part[-1]) + 1) for part in np.split(own, ends) if len(part)]
    return [part for part in found if part.stop - part.start >= shortest_s * FRAME_RATE_HZ]


def by_domain(values: Sequence[np.ndarray], clips: Sequence[Track], domain: int) -> float:
    """Mean of a per-frame measure over all frames of a domain; for silence over settled frames only."""
    picked = [
        value[(settled(clip.domain) if domain == SILENCE else clip.domain == domain)[1:]]
        for value, clip in zip(values, clips, strict=True)
    ]
    joined = np.concatenate(picked) if picked else np.zeros(0)
    return float(joined.mean()) if len(joined) else float("nan")


def border_speed_ratio(clips: Sequence[Track], chunk: ChunkSize = CHUNK) -> float:
    """Mean joint speed across chunk borders over that inside chunks."""
    return _at_borders(clips, 1, [chunk.frames - 1], chunk)


def border_ratio(clips: Sequence[Track], chunk: ChunkSize = CHUNK) -> float:
    """Mean joint acceleration at chunk borders over that inside chunks; 1 means that borders are invisible."""
    return _at_borders(clips, 2, [chunk.frames - 2, chunk.frames - 1], chunk)  # each is of the frame that follows


def _at_borders(clips: Sequence[Track], order: int, places: Sequence[int], chunk: ChunkSize) -> float:
    """Mean difference of that order at these places of a chunk, over the mean at all others."""
    changes = [np.linalg.norm(np.diff(clip.positions, n=order, axis=0), axis=-1).mean(1) for clip in clips]
    is_border = np.concatenate([np.isin(np.arange(len(change)) % chunk.frames, places) for change in changes])
    change = np.concatenate(changes)
    return float(change[is_border].mean() / change[~is_border].mean())
