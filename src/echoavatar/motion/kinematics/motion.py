"""Motion: a skeleton and its movement, as an immutable value."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from echoavatar.errors import MotionError

from .forward import Pose, forward_kinematics
from .rotations import matrix_from_quaternion
from .skeleton import Skeleton


@dataclass(frozen=True)
class Motion:
    """Frames of one skeleton.

    Attributes:
        skeleton: the rig.
        rotations: (t, j, 4) float32 parent-relative unit quaternions `wxyz`.
        root: (t, 3) float32 world position of the root, metres.
        fps: frames per second.
    """

    skeleton: Skeleton
    rotations: NDArray[np.float32]
    root: NDArray[np.float32]
    fps: float

    def __post_init__(self) -> None:
        """Raise MotionError for shapes that do not fit, no frames, or values that are not finite."""
        t, joints = self.frames, self.skeleton.joints
        if t == 0:
            raise MotionError("the motion has no frames; record it again or choose another")
        if self.rotations.shape != (t, joints, 4) or self.root.shape != (t, 3):
            raise MotionError(
                f"rotations {self.rotations.shape} and root {self.root.shape} do not fit {joints} joints;"
                f" expected ({t}, {joints}, 4) and ({t}, 3)"
            )
        if not (np.isfinite(self.rotations).all() and np.isfinite(self.root).all()):
            raise MotionError("the motion holds values that are not finite; repair these frames or leave them out")
        if not 0 < self.fps < 10_000:
            raise MotionError(f"{self.fps} frames per second is not a frame rate; give one between 0 and 10,000")

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return int(self.root.shape[0])

    @property
    def seconds(self) -> float:
        """Length in seconds."""
        return self.frames / self.fps

    def matrices(self) -> Float[Tensor, "t j 3 3"]:
        """Parent-relative rotation matrices."""
        return matrix_from_quaternion(torch.from_numpy(self.rotations))

    def pose(self) -> Pose:
        """World rotations and positions of every joint and frame."""
        return forward_kinematics(self.skeleton, self.matrices(), torch.from_numpy(self.root))

    def cut(self, start: int, stop: int) -> "Motion":
        """Frames `start` to `stop`, which is not included."""
        return replace(self, rotations=self.rotations[start:stop], root=self.root[start:stop])

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Plain arrays: `rotations` (t, j, 4) `wxyz`, `root` (t, 3) in metres, `fps`, `joints` and `parents` (j)."""
        return {
            "rotations": self.rotations,
            "root": self.root,
            "fps": np.array(self.fps),
            "joints": np.array(self.skeleton.names),
            "parents": np.array(self.skeleton.parents),
        }
