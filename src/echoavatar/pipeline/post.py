"""From decoded features to a pose that holds together: calm, ground, feet, hands (paper, Online Post-Processing).

All in numpy with components first (`kinematics.lanes`): a chunk of one session is some hundreds of small arrays, and
what costs is the number of operations, not their size. One forward kinematics in the root's frame serves all stages.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..ik import HandGuard
from ..ik.chains import Chains
from ..kinematics import Skeleton, lanes
from ..kinematics.features import travel_slice
from ..nn import StreamState
from ..timing import FRAME_RATE_HZ
from .calm import Calm, CalmState
from .feet import Feet, FeetState
from .ground import Ground, GroundState
from .motion_chunk import MotionChunk
from .pose import Array, Legs, PoseLanes

Lap = Callable[[str], None]
POST_STAGES = ("pose", "calm", "ground", "feet", "hands")


@dataclass
class PostState(StreamState):
    """What the stages remember."""

    calm: CalmState
    ground: GroundState
    feet: FeetState


class Post:
    """The stages between the tokenizer's decoder and the session, in a row."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.hands = HandGuard(skeleton)
        feet = skeleton.config.feet
        self.chains = Chains(skeleton, [0, *self.hands.joints, *feet])
        self.hands.stand_on(self.chains)
        self._points = np.array([self.chains.slot[joint] for joint in feet], np.int64)
        self.calm, self.ground = Calm(skeleton.joints), Ground(skeleton)
        self.feet = Feet(skeleton, self.chains)
        self._travel = travel_slice(skeleton)
        self._rows, self._moving = _feature_rows(skeleton)

    def init_state(self, rows: int) -> PostState:
        """Nothing shown yet."""
        return PostState(self.calm.init_state(rows), self.ground.init_state(rows), self.feet.init_state(rows))

    def step(
        self,
        features: Float[Tensor, "b t c"],
        state: PostState,
        active: Bool[Tensor, " b"],
        lap: Callable[[str], None],
    ) -> list[MotionChunk]:
        """Motion of a chunk; after each stage `lap(stage)` is called."""
        on = None if bool(active.all()) else active.numpy()
        pose = self.pose_of(features)
        lap("pose")
        self.calm.step(pose, state.calm, on)
        lap("calm")
        legs = self.kinematics(pose)
        self.ground.step(pose, legs.points, state.ground, on)
        lap("ground")
        self.feet.step(pose, legs, state.feet, on)
        lap("feet")
        self.hands.guard(pose.flat(), legs.frames)
        chunks = chunks_of(pose)
        lap("hands")
        return chunks

    def pose_of(self, features: Float[Tensor, "b t c"], fps: float = FRAME_RATE_HZ) -> PoseLanes:
        """Rotations, and travel as decoded."""
        columns = features.permute(2, 1, 0).contiguous().numpy()
        turns = lanes.from_two_rows(columns[self._rows])
        if self._moving is not None:
            still = np.zeros((4, self.skeleton.joints, *turns.shape[2:]), np.float32)
            still[0], still[:, self._moving] = 1, turns
            turns = still
        return PoseLanes(turns, columns[self._travel][[0, 2, 1]], fps)

    def kinematics(self, pose: PoseLanes) -> Legs:
        """Forward kinematics of all that the stages look at."""
        local = self.chains.local_of(pose.flat())
        frames, hips = self.chains.world(local), local[:3, :3, 0]
        points = lanes.apply(hips[:, :, None], frames[:, 3, self._points])
        return Legs(frames, hips, points.reshape(3, len(self._points), *pose.root.shape[1:]))


def chunks_of(pose: PoseLanes) -> list[MotionChunk]:
    """One chunk for each row, quaternions with w >= 0."""
    turns = pose.turns * np.copysign(np.float32(1), pose.turns[:1])
    rotations = torch.from_numpy(turns).permute(3, 2, 1, 0).contiguous().numpy()
    root = np.ascontiguousarray(pose.root.transpose(2, 1, 0))
    return [MotionChunk(q, r) for q, r in zip(rotations, root, strict=True)]


def _feature_rows(skeleton: Skeleton) -> tuple[Array, Array | None]:
    """Feature channels of each joint's 6D (6, j), ascending joints; and these joints, when they are not all."""
    travel, joints = travel_slice(skeleton), np.array(skeleton.feature_joints)
    six = np.arange(6 * len(joints)).reshape(len(joints), 6)
    six += np.where(six >= travel.start, travel.stop - travel.start, 0)
    order = np.argsort(joints)
    is_whole = len(joints) == skeleton.joints
    return np.ascontiguousarray(six[order].T), None if is_whole else joints[order]
