"""Baselines without trained weights, which give scores a scale.

- `mean`: the mean pose of the training motion, standing still. Best possible for errors of position, worst for life.
- `random`: stretches of training motion, whatever the audio. As lifelike as the data; what a model scores beyond it is
  what listening adds.
- `nearest`: for every 2.1 s of audio the training motion whose audio was most similar (log mel spectra).

Stretches are joined so that place and heading continue where the last one ended. The pose is not blended and jumps at
the seams (every 2.1 s for `nearest`).
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import AudioError, MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.rotations import (
    matrix_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_multiply,
)
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar_lab.data import Clip
from echoavatar_lab.evaluation.metrics.positions import heading, turn_about_up
from echoavatar_lab.models.audio.mel import log_mel

Kind = Literal["mean", "random", "nearest"]
BASELINES: dict[str, Kind] = {"Mean pose": "mean", "Random clip": "random", "Nearest sound": "nearest"}
STRETCH_FRAMES = 64
STRIDE_FRAMES = 8
BLOCK_FRAMES = 4
_FFT, _BANDS = 2048, 24


class Stretch(NamedTuple):
    """Frames `start` to `stop` of a training clip."""

    clip: int
    start: int
    stop: int


class _Library(NamedTuple):
    """Spectra of every stretch of the training audio, its position, and the statistics that normalised them."""

    rows: Float[np.ndarray, "n d"]
    places: list[tuple[int, int]]
    mean: Float[np.ndarray, " m"]
    spread: Float[np.ndarray, " m"]


class Baselines:
    """Training clips and the three baselines made from them."""

    def __init__(self, clips: Sequence[Clip], skeleton: Skeleton = HUMANOID) -> None:
        """Clips on the rig `skeleton`; raises MotionError if there are none."""
        if not clips:
            raise MotionError("there are no training clips; make a longer corpus")
        self.clips, self.skeleton = list(clips), skeleton

    def make(self, kind: Kind, audio: Float[np.ndarray, " s"], *, seed: int = 0) -> Motion:
        """Motion as long as the audio (24 kHz), in whole frames.

        Raises AudioError if there is less than a frame of audio.
        """
        frames = len(audio) // SAMPLES_PER_FRAME
        if not frames:
            raise AudioError(f"the audio has {len(audio)} samples, less than a frame; use a longer file")
        if kind == "mean":
            return self.mean_pose(frames)
        return self.joined(self.at_random(frames, seed) if kind == "random" else self.nearest(audio))

    def mean_pose(self, frames: int) -> Motion:
        """The mean of all poses without heading, at the mean height."""
        total, heights = torch.zeros(self.skeleton.joints, 4, 4), []
        for clip in self.clips:
            turned = torch.from_numpy(facing(clip.rotations, clip.root)[0])
            total += torch.einsum("tjx,tjy->jxy", turned, turned)
            heights.append(clip.root[:, 1])
        mean = torch.linalg.eigh(total.double())[1][..., -1].float()  # principal axis: ignores quaternion signs
        root = np.array([0.0, np.concatenate(heights).mean(), 0.0], np.float32)
        rotations = (mean * torch.where(mean[:, :1] < 0, -1.0, 1.0)).numpy()
        return Motion(
            self.skeleton, np.tile(rotations, (frames, 1, 1)), np.tile(root, (frames, 1)), float(FRAME_RATE_HZ)
        )

    def at_random(self, frames: int, seed: int) -> list[Stretch]:
        """Stretches of random training clips from random positions, as many as needed."""
        random, found, left = np.random.default_rng(seed), [], frames
        while left:
            clip = int(random.integers(len(self.clips)))
            length = min(left, self.clips[clip].frames)
            start = int(random.integers(self.clips[clip].frames - length + 1))
            found.append(Stretch(clip, start, start + length))
            left -= length
        return found

    def nearest(self, audio: Float[np.ndarray, " s"]) -> list[Stretch]:
        """For each stretch of audio the stretch of training audio with the nearest spectra."""
        library = self._library
        bands = (spectra(audio) - library.mean) / library.spread
        frames, found = len(bands), []
        for start in range(0, frames, STRETCH_FRAMES):
            part = bands[start : start + STRETCH_FRAMES]
            length = len(part)
            query = _blocks(np.pad(part, ((0, STRETCH_FRAMES - length), (0, 0)), mode="edge"))
            clip, at = library.places[int(((library.rows - query) ** 2).sum(1).argmin())]
            found.append(Stretch(clip, at, at + length))
        return found

    def joined(self, stretches: Sequence[Stretch]) -> Motion:
        """Concatenate stretches; the root continues from its last position and heading."""
        rotations, roots = [], []
        place, yaw = np.zeros(2, np.float32), 0.0
        for clip, start, stop in stretches:
            own = self.clips[clip]
            turned, root = facing(own.rotations[start:stop], own.root[start:stop], yaw)
            root[:, [0, 2]] += place - root[0, [0, 2]]
            place = root[-1, [0, 2]]
            last = torch.from_numpy(matrix_from_quaternion(turned[-1:, 0]))
            yaw = float(heading(last)[0])
            rotations.append(turned)
            roots.append(root)
        return Motion(self.skeleton, np.concatenate(rotations), np.concatenate(roots), float(FRAME_RATE_HZ))

    @cached_property
    def _library(self) -> "_Library":
        every = [spectra(clip.audio) for clip in self.clips]
        joined = np.concatenate(every)
        mean, spread = joined.mean(0), joined.std(0) + 1e-6
        rows, places = [], []
        for number, bands in enumerate(every):
            normal = (bands - mean) / spread
            for start in range(0, len(normal) - STRETCH_FRAMES + 1, STRIDE_FRAMES):
                rows.append(_blocks(normal[start : start + STRETCH_FRAMES]))
                places.append((number, start))
        if not rows:
            raise MotionError(f"no training clip has {STRETCH_FRAMES} frames; make a corpus of longer clips")
        return _Library(np.array(rows, np.float32), places, mean, spread)


def facing(
    rotations: Float[np.ndarray, "t j 4"], root: Float[np.ndarray, "t 3"], yaw: float | None = None
) -> tuple[Float[np.ndarray, "t j 4"], Float[np.ndarray, "t 3"]]:
    """Rotate a clip about the vertical so that it starts facing `yaw`; None: every frame faces +Z."""
    hips = rotations[:, 0].astype(np.float32)
    own = heading(torch.from_numpy(matrix_from_quaternion(hips))).numpy()
    turn = -own if yaw is None else np.full_like(own, yaw - own[0])
    turned = rotations.copy()
    turned[:, 0] = quaternion_multiply(
        quaternion_from_axis_angle(np.outer(turn, np.array([0, 1, 0], np.float32))), hips
    )
    moved = turn_about_up(torch.from_numpy(-turn)).numpy() @ root.astype(np.float32)[..., None]
    return turned, moved[..., 0]


def spectra(audio: Float[np.ndarray, " s"]) -> Float[np.ndarray, "t m"]:
    """Log mel spectra, one for each motion frame."""
    frames = len(audio) // SAMPLES_PER_FRAME
    waves = torch.from_numpy(np.ascontiguousarray(audio, np.float32))[None]
    bands = log_mel(waves, fft=_FFT, hop=SAMPLES_PER_FRAME, bands=_BANDS)[0, :frames]
    return np.asarray(bands.numpy())


def _blocks(bands: Float[np.ndarray, "t m"]) -> Float[np.ndarray, " d"]:
    """Means over four frames, so that similarity tolerates shifts of a seventh of a second."""
    return np.asarray(bands.reshape(len(bands) // BLOCK_FRAMES, BLOCK_FRAMES, -1).mean(1).reshape(-1))
