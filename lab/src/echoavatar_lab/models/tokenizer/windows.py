"""Training windows: 64 frames cut anywhere from the corpus, half of them mirrored (paper, Motion Tokenizer)."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import FeatureStatistics, Skeleton, measure_features, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.timing import FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.data.clip import mirror_features

ROTATION_FLOOR = 0.03  # about two degrees: quieter rotation features are not blown up to unit spread
BONE_REACH = 0.05  # metres
TRAVEL_FLOOR = (0.002, 0.002, 0.01)  # metres per frame, metres per frame, metres


class MovingBody(Protocol):
    """The part of a clip that tokenizer training uses; `data.Clip` and `data.ClipMotion` both fit."""

    @property
    def rotations(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        """(t, j, 4) quaternions `wxyz`."""

    @property
    def root(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        """(t, 3) metres."""


def clip_features(skeleton: Skeleton, clip: MovingBody) -> Float[Tensor, "t c"]:
    """Motion features of a clip."""
    rotations = matrix_from_quaternion(torch.from_numpy(np.asarray(clip.rotations, np.float32)))
    return to_features(skeleton, rotations, torch.from_numpy(np.asarray(clip.root, np.float32)))


def reach_statistics(
    skeleton: Skeleton, features: Iterable[Float[Tensor, "_ c"]], *, is_mirrored: bool
) -> FeatureStatistics:
    """Statistics whose spread is a joint's own, divided by the root of how much of the body hangs on the joint.

    Ours: latents and codes then spend their precision on joints whose rotation moves much of the body.
    Reach is the root of the summed squared distances to all joints below, plus five centimetres for the bone itself.
    """
    statistics = floored_statistics(skeleton, features, is_mirrored=is_mirrored)
    joints = list(skeleton.feature_joints)
    reach = joint_reach(skeleton)[joints].repeat_interleave(6)
    end = 6 * len(next(iter(skeleton.config.parts.values())))
    std = statistics.std.clone()
    columns = torch.cat([torch.arange(end), torch.arange(end + len(TRAVEL_FLOOR), len(std))])
    own = std[columns]
    scaled = (own / reach).sqrt()
    start = 0
    for part in skeleton.config.parts.values():
        here = slice(start, start + 6 * len(part))
        level = (own[here] / scaled[here]).mean()
        std[columns[here]] = scaled[here] * level
        start = here.stop
    return FeatureStatistics(statistics.mean, std, statistics.varies)


def joint_reach(skeleton: Skeleton) -> Float[Tensor, " j"]:
    """How far the body hangs on each joint, metres (see `reach_statistics`)."""
    places = skeleton.rest_positions
    squares = torch.full((skeleton.joints,), BONE_REACH**2)
    for joint in range(skeleton.joints):
        above = skeleton.parents[joint]
        while above >= 0:
            squares[above] += (places[joint] - places[above]).square().sum()
            above = skeleton.parents[above]
    return squares.sqrt()


def floored_statistics(
    skeleton: Skeleton, features: Iterable[Float[Tensor, "_ c"]], *, is_mirrored: bool
) -> FeatureStatistics:
    """Corpus statistics with a floor under the spread.

    Departs from the paper, which divides by the plain spread: there a joint that hardly moves weighs as much as an arm.
    """
    both = ([clip, mirror_features(skeleton, clip)] if is_mirrored else [clip] for clip in features)
    mean, std, varies = measure_features(clip for pair in both for clip in pair)
    floor = torch.full_like(std, ROTATION_FLOOR)
    end = 6 * len(next(iter(skeleton.config.parts.values())))
    floor[end : end + 3] = torch.tensor(TRAVEL_FLOOR)
    return FeatureStatistics(mean, torch.maximum(std, floor), varies)


class WindowSampler:
    """Draws batches of windows, every frame of the corpus equally likely; all randomness comes from one generator."""

    def __init__(
        self, skeleton: Skeleton, clips: Sequence[Float[Tensor, "_ c"]], *, frames: int, is_mirrored: bool
    ) -> None:
        if frames % FRAMES_PER_MOTION_TOKEN:
            raise ValueError(f"window of {frames} frames is not a multiple of {FRAMES_PER_MOTION_TOKEN}")
        long_enough = [clip for clip in clips if len(clip) >= frames]
        if not long_enough:
            raise MotionError(f"no clip has {frames} frames; make a corpus with longer clips")
        self.skeleton = skeleton
        self.frames = frames
        self.is_mirrored = is_mirrored
        self.features = torch.cat(long_enough)
        lengths = torch.tensor([len(clip) for clip in long_enough])
        ends = lengths.cumsum(0)
        self.starts = torch.cat(
            [torch.arange(int(end - length), int(end) - frames + 1) for end, length in zip(ends, lengths, strict=True)]
        )

    def draw(self, batch: int, generator: torch.Generator) -> Float[Tensor, "b t c"]:
        """A batch of windows, features not normalised."""
        chosen = self.starts[torch.randint(len(self.starts), (batch,), generator=generator)]
        windows = self.features[chosen[:, None] + torch.arange(self.frames)]
        if self.is_mirrored:
            flipped = torch.rand(batch, generator=generator) < 0.5
            windows = torch.where(flipped[:, None, None], mirror_features(self.skeleton, windows), windows)
        return windows
