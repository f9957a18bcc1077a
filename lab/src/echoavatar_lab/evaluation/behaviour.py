"""How the body behaves: energy by domain, stillness in silence, planted feet, smoothness, chunk borders.

Every measure is a plain function of motion and of the domain heard in each frame. Names carry the units.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Integer

from echoavatar.motion.kinematics import Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_quaternion
from echoavatar.timing import CHUNK, FRAME_RATE_HZ, ChunkSize

SILENCE, SPEECH, MUSIC = 0, 1, 2
SETTLE_FRAMES = 30  # frames at the start of a silence that do not count yet
LONG_SILENCE_FRAMES = 60


@dataclass(frozen=True)
class Track:
    """Motion of one clip, and the domain of its audio."""

    positions: Float[np.ndarray, "t j 3"]
    angular_speed: Float[np.ndarray, "t-1 j"]  # degrees per second
    domain: Integer[np.ndarray, " t"]


def track(
    skeleton: Skeleton,
    rotations: Float[np.ndarray, "t j 4"],
    root: Float[np.ndarray, "t 3"],
    domain: Integer[np.ndarray, " t"],
) -> Track:
    """World positions and joint speeds of a clip of quaternions `wxyz` and root positions."""
    matrices = matrix_from_quaternion(torch.from_numpy(np.ascontiguousarray(rotations)).float())
    positions = forward_kinematics(skeleton, matrices, torch.from_numpy(np.ascontiguousarray(root)).float()).positions
    turn = torch.rad2deg(angle_between(matrices[:-1], matrices[1:])) * FRAME_RATE_HZ
    return Track(positions.numpy(), turn.numpy(), domain)


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
    at_border, inside = [], []
    for clip in clips:
        speed = np.linalg.norm(np.diff(clip.positions, axis=0), axis=-1).mean(1)
        border = np.arange(len(speed)) % chunk.frames == chunk.frames - 1
        at_border.append(speed[border])
        inside.append(speed[~border])
    return float(np.concatenate(at_border).mean() / np.concatenate(inside).mean())


def border_ratio(clips: Sequence[Track], chunk: ChunkSize = CHUNK) -> float:
    """Mean joint acceleration at chunk borders over that inside chunks; 1 means that borders are invisible."""
    at_border, inside = [], []
    for clip in clips:
        change = np.linalg.norm(np.diff(clip.positions, n=2, axis=0), axis=-1).mean(1)
        frame = np.arange(len(change)) + 1  # the middle frame of each second difference
        border = (frame % chunk.frames == 0) | (frame % chunk.frames == chunk.frames - 1)
        at_border.append(change[border])
        inside.append(change[~border])
    return float(np.concatenate(at_border).mean() / np.concatenate(inside).mean())
