"""No joint turns faster than the smoother allows, also where a later stage moves it.

A hand that would pass through the body is pushed out of it, and where the nearest way out changes sides, so does the
hand, from one frame to the next. This stage spreads such a turn over the frames that it takes at `FASTEST`.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar.nn.kernels import kernel

from ..kinematics.quaternions import read_quaternion, write_quaternion
from .pose import Array, Pose
from .smoother import FASTEST, slowed_down


@dataclass
class SpeedLimitState(StreamState):
    """The last rotations shown; zero where nothing was shown yet."""

    rotations: Float[Tensor, "b j 4"]


class SpeedLimit:
    """Holds back joints that turn faster than `FASTEST`."""

    def __init__(self, joints: int) -> None:
        self._joints = joints

    def init_state(self, rows: int) -> SpeedLimitState:
        """Nothing shown yet."""
        return SpeedLimitState(torch.zeros(rows, self._joints, 4))

    def step(self, pose: Pose, state: SpeedLimitState, active: Bool[Array, " b"]) -> None:
        """Hold back the rotations of active rows, in place."""
        hold_back(pose.rotations, state.rotations.numpy(), active, math.cos(FASTEST / pose.fps / 2))


@kernel()
def hold_back(rotations, shown, active, cosine):  # type: ignore[no-untyped-def]
    """Turn every joint of active rows towards its rotation in each frame, by an angle of at most twice acos(cosine)."""
    for row in range(len(rotations)):
        if not active[row]:
            continue
        is_new = not shown[row, 0].any()
        for joint in range(rotations.shape[2]):
            now = rotations[row, :, joint]
            last = read_quaternion(now[0] if is_new else shown[row, joint])
            for frame in range(len(now)):
                last = slowed_down(last, read_quaternion(now[frame]), cosine)
                write_quaternion(now[frame], last)
            write_quaternion(shown[row, joint], last)
