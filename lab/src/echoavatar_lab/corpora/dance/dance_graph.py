"""Captured dances cut into stretches of whole counts, which are found by tempo and by the pose they begin with.

A stretch may follow where pose and velocity are alike. Stretches are dropped whose counts would have to be played too
slowly or too fast, that go down to the floor, or in which a joint would turn too fast.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import FRAME_RATE_HZ

from ..capture.library import CapturedLibrary
from ..controls import Array, Controls, mirrored, smoothed, turned
from ..solver import solve
from .dance_counts import braking, find_counts

RATES, USUAL_RATE = (0.65, 1.9), 1.4  # of playback between two counts; a count lasts 1/4 to 2 beats accordingly
FASTEST_DEG_S = 1000.0  # of a joint as it is played
LOWEST_M, MOST_BENT = 0.58, 1.1  # of the hips: floor work is left out
STEEPEST, MOST_TILT = 1.1, 0.85  # radians: pitch and roll of a foot
FASTEST_TURN = 0.7  # radians from frame to frame: a foot that turns faster flips
BACKWARDS = -0.1  # cosine of a foot's heading against that of the hips
VELOCITY_S = 0.12  # weight of velocities against positions


@dataclass(frozen=True, eq=False)
class Dance:
    """One captured dance, or its mirror image.

    Attributes:
        group: dances of one group look alike.
        controls: curves at 30 fps.
        counts: frames of the counts.
        fastest: speed of the fastest joint from each count to the next, degrees per second; infinite in floor work.
        sums: over the frames before: cosine and sine of the heading, place x and z, energy.
        strong: 0 if the even counts are hit harder, otherwise 1.
        poses: pose and velocity of the whole body in metres, as `_poses` measures them.
    """

    group: str
    controls: Controls
    counts: Float[Array, " n"]
    fastest: Float[Array, " n-1"]
    sums: Float[Array, "t+1 5"]
    strong: int
    poses: Float[Array, "t d"]

    def at(self, frames: Float[np.ndarray, " k"]) -> Controls:
        """Curves at fractional frames."""
        low, high = max(0, int(frames.min()) - 3), int(frames.max()) + 5
        table = self.controls[low:high].packed().astype(np.float64)
        inside = np.clip(frames - low, 0, len(table) - 1)
        return Controls.unpacked(CubicSpline(np.arange(len(table)), table)(inside))


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of one length in beats, as arrays over all of them: their places, their movement and their poses."""

    dance: Int[Array, " k"]
    first: Int[Array, " k"]  # count
    counts: Int[Array, " k"]
    poses: Float[Array, "k d"]  # of the body at the beginning
    heading: Float[Array, " k"]  # mean turn against the beginning
    way: Float[Array, "k 2"]  # mean place, x and z, seen from the beginning
    energy: Float[Array, " k"]
    rate: Float[Array, " k"]

    def __len__(self) -> int:
        return len(self.dance)


@lru_cache(maxsize=8)
def stretches_of(dances: tuple[Dance, ...], groups: tuple[str, ...], beats: int, beat_s: float) -> Stretches:
    """Stretches of so many beats of the given length by dancers of some groups."""
    found = [_fitting(number, dance, beats, beat_s) for number, dance in enumerate(dances) if dance.group in groups]
    found = [columns for columns in found if columns is not None]
    if not found:
        whole, real = np.zeros(0, np.int64), np.zeros(0)
        return Stretches(whole, whole, whole, np.zeros((0, 1)), real, np.zeros((0, 2)), real, real)
    return Stretches(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _fitting(number: int, dance: Dance, beats: int, beat_s: float) -> tuple[Array, ...] | None:
    """The stretches of one dance that fit a tempo: the fields of `Stretches`, in order; None if no stretch can fit."""
    gaps = np.diff(dance.counts) / FRAME_RATE_HZ
    middle = float(np.median(gaps)) if len(gaps) else beat_s
    unit = float(np.clip(2.0 ** np.round(np.log2(middle / beat_s / USUAL_RATE)), 0.25, 2.0))  # beats in a count
    size = round(beats / unit)
    if size * unit != beats or size > len(gaps):
        return None
    step = 2 if unit < 1 else 1
    first = np.arange(dance.strong % step, len(gaps) - size + 1, step)
    windows = sliding_window_view(gaps / (unit * beat_s), size)[first]
    rate, fastest = windows.mean(1), sliding_window_view(dance.fastest, size)[first].max(1)
    good = (windows.min(1) > RATES[0]) & (windows.max(1) < RATES[1]) & (fastest * rate < FASTEST_DEG_S)
    first, rate = first[good], rate[good]
    starts = np.round(dance.counts).astype(int)
    a, b = starts[first], starts[first + size]
    cos, sin, x, z, energy = ((dance.sums[b] - dance.sums[a]) / np.maximum(b - a, 1)[:, None]).T
    yaw = dance.controls.pelvis_rotation[a, 0]
    way = turned(np.stack([x, z], 1) - dance.controls.pelvis_position[a][:, [0, 2]], -yaw)
    heading = np.arctan2(sin, cos) - yaw
    return np.full(len(a), number), first, np.full(len(a), size), dance.poses[a], heading, way, energy, rate


@lru_cache(maxsize=2)
def dance_graph(library: CapturedLibrary) -> tuple[Dance, ...]:
    """All dances of a library with their mirror images; takes some seconds, once in a process."""
    found: list[Dance] = []
    for clip in library.of("dance"):
        rotations, root = solve(clip.controls)
        positions = Motion(HUMANOID, rotations, root, float(FRAME_RATE_HZ)).pose().positions
        counts = find_counts(positions)
        hits = braking(positions)[np.clip(np.round(counts).astype(int), 0, len(positions) - 1)]
        strong = int(len(hits) > 1 and hits[1::2].mean() > hits[::2].mean())
        fastest, energy = joint_speed(rotations), _energy(positions)
        for side in range(2):
            own = mirrored(clip.controls) if side else clip.controls
            between, sums = _between(fastest, own, counts), _sums(own, energy)
            found.append(Dance(clip.group, own, counts, between, sums, strong, _poses(own)))
    return tuple(found)


def _between(fastest: Float[Array, " t"], controls: Controls, counts: Float[Array, " n"]) -> Float[Array, " n-1"]:
    """Speed of the fastest joint between counts; infinite on the floor and with a foot that is steep or turned back."""
    low = controls.pelvis_position[:, 1] < LOWEST_M
    bent = np.abs(controls.pelvis_rotation[:, 1]) > MOST_BENT
    steep = ((np.abs(controls.foot_pitch) > STEEPEST) | (np.abs(controls.foot_roll) > MOST_TILT)).any(1)
    flips = (np.abs(np.diff(controls.foot_yaw, axis=0, append=controls.foot_yaw[-1:])) > FASTEST_TURN).any(1)
    away = (np.cos(controls.foot_yaw - controls.pelvis_rotation[:, :1]) < BACKWARDS).any(1)
    speed = np.where(low | bent | steep | flips | away, np.inf, fastest)
    frames = np.round(counts).astype(int)
    return np.array([speed[a : b + 1].max() for a, b in zip(frames[:-1], frames[1:], strict=True)])


def _sums(controls: Controls, energy: Float[Array, " t"]) -> Float[Array, "t+1 5"]:
    yaw = controls.pelvis_rotation[:, 0].astype(np.float64)
    place = controls.pelvis_position.astype(np.float64)
    table = np.stack([np.cos(yaw), np.sin(yaw), place[:, 0], place[:, 2], energy], 1)
    return np.concatenate([np.zeros((1, 5)), np.cumsum(table, axis=0)])


def joint_speed(rotations: Float[np.ndarray, "t j 4"]) -> Float[Array, " t"]:
    """Speed of the fastest joint, degrees a second."""
    turn = 2 * np.arccos(np.abs((rotations[1:] * rotations[:-1]).sum(-1)).clip(0, 1))
    return np.asarray(np.pad(np.degrees(turn).max(1) * FRAME_RATE_HZ, (0, 1), mode="edge"))


def _energy(positions: Float[np.ndarray, "t j 3"]) -> Float[Array, " t"]:
    """Mean speed of the body's joints against 1.7 m/s."""
    speed = np.linalg.norm(np.gradient(positions, axis=0), axis=-1).mean(1) * FRAME_RATE_HZ
    return np.asarray(gaussian_filter1d(speed, 8.0, mode="nearest") / 1.7)


def _poses(controls: Controls) -> Float[Array, "t d"]:
    """Pose and velocity of the whole body in metres, seen from the hips and the floor below them."""
    yaw = controls.pelvis_rotation[:, :1]
    feet = turned(controls.foot_position - controls.pelvis_position[:, None], -yaw)
    travel = np.gradient(controls.pelvis_position, axis=0)[:, None] * FRAME_RATE_HZ
    toes = controls.foot_yaw - yaw
    parts = [
        1.3 * feet.reshape(len(feet), -1),
        0.35 * np.concatenate([np.sin(toes), np.cos(toes)], 1),
        0.13 * controls.foot_pitch,
        controls.pelvis_position[:, 1:2],
        0.5 * controls.pelvis_rotation[:, 1:],
        0.4 * controls.spine,
        0.15 * controls.head,
        0.6 * controls.wrist.reshape(len(feet), -1),
    ]
    pose = np.concatenate(parts, 1)
    speed = np.gradient(smoothed(pose, 0.03), axis=0) * FRAME_RATE_HZ
    turning = 0.15 * np.gradient(smoothed(yaw, 0.05), axis=0) * FRAME_RATE_HZ
    moving = VELOCITY_S * np.concatenate([speed, turned(travel, -yaw).reshape(len(feet), -1), turning], 1)
    return np.concatenate([pose, moving], 1).astype(np.float32)
