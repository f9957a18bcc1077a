"""From decoded features to a pose that holds together: calm, ground, leash, feet, hands (paper, Post-Processing).

All in numpy with components first (`kinematics.lanes`): a chunk of one session is some hundreds of small arrays, and
what costs is the number of operations, not their size. One forward kinematics in the root's frame serves all stages.
Every stage but the first can be left out by name. Rotations that are not finite, or from which no rotation can be made,
are repaired (`repair`), reported by `repaired` and in the log.
"""

import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..errors import EchoAvatarError
from ..ik import BodyProfile, HandGuard
from ..ik.chains import Chains
from ..kinematics import Motion, Skeleton, lanes, to_features
from ..kinematics.features import travel_slice
from ..nn import StreamState
from ..timing import CHUNK_FRAMES, FRAME_RATE_HZ
from .calm import Calm, CalmState
from .feet import LARGEST, Feet, FeetState
from .ground import Ground, GroundState
from .leash import Leash, LeashState
from .modes import FREE, IdleLegs, ModesState, MotionOptions
from .motion_chunk import MotionChunk
from .pose import Array, Legs, PoseLanes
from .repair import repair

Lap = Callable[[str], None]
POST_STAGES = ("pose", "calm", "ground", "leash", "feet", "hands")
SWITCHES = POST_STAGES[1:]
LARGEST_ON_LEASH = 0.30  # metres a foot may be held from where it was decoded, in rows whose root is held too
_log = logging.getLogger(__name__)


@dataclass
class PostState(StreamState):
    """What the stages remember."""

    modes: ModesState
    calm: CalmState
    ground: GroundState
    leash: LeashState
    feet: FeetState


class Post:
    """The stages between the tokenizer's decoder and the session, in a row."""

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        stages: Collection[str] = SWITCHES,
        body: BodyProfile | None = None,
    ) -> None:
        """`stages` are those to run; `body` is the character's thickness (`echoavatar rig`), our own by default.

        Raises:
            EchoAvatarError: there is no stage of that name.
        """
        if unknown := sorted(set(stages) - set(SWITCHES)):
            raise EchoAvatarError(
                f"no stage {unknown[0]!r} behind the decoder; there are {', '.join(SWITCHES)}"
            )
        self.skeleton, self.stages, self.repaired = skeleton, frozenset(stages), 0
        self.hands = HandGuard(skeleton, body)
        feet = skeleton.config.feet
        self.chains = Chains(skeleton, [0, *self.hands.joints, *feet])
        self.hands.stand_on(self.chains)
        self._points = np.array([self.chains.slot[joint] for joint in feet], np.int64)
        self.calm, self.ground = Calm(skeleton.joints), Ground(skeleton, is_holding="ground" in stages)
        self.leash, self.idle = Leash(), IdleLegs(skeleton)
        self.feet = Feet(skeleton, self.chains)
        self._travel = travel_slice(skeleton)
        self._rows, self._moving = _feature_rows(skeleton)

    def init_state(self, rows: int) -> PostState:
        """Nothing shown yet, free rows."""
        return PostState(
            self.idle.init_state(rows),
            self.calm.init_state(rows),
            self.ground.init_state(rows),
            self.leash.init_state(rows),
            self.feet.init_state(rows),
        )

    def step(
        self,
        features: Float[Tensor, "b t c"],
        state: PostState,
        active: Bool[Tensor, " b"],
        lap: Callable[[str], None],
    ) -> list[MotionChunk]:
        """Motion of a chunk; after each stage `lap(stage)` is called, also after those left out."""
        on = None if bool(active.all()) else active.numpy()
        pose = self.pose_of(features, state)
        lap("pose")
        if "calm" in self.stages:
            self.calm.step(pose, state.calm, on)
        lap("calm")
        leash, is_pinned, is_idle = state.modes.options.numpy().T
        is_idle = is_idle > 0 if is_idle.any() else None
        if is_idle is not None:
            self.idle.stand(pose, is_idle)
        legs = self.kinematics(pose)
        self.ground.step(pose, legs.points, state.ground, on)
        if is_idle is not None:
            self.idle.sway(pose, is_idle, state.modes, on)
        lap("ground")
        largest: Array | float = LARGEST
        decoded_root = None
        if "leash" in self.stages and (leash.any() or is_pinned.any()):
            lean, decoded_root = state.feet.lean(), pose.root.copy()
            self.leash.step(pose, state.leash, on, radius=leash, is_pinned=is_pinned > 0, lean=lean)
            largest = np.where((leash > 0) | (is_pinned > 0), LARGEST_ON_LEASH, LARGEST)
        lap("leash")
        if "feet" in self.stages:
            self.feet.step(pose, legs, state.feet, on, decoded_root=decoded_root, largest=largest)
        lap("feet")
        if "hands" in self.stages:
            self.hands.guard(pose.flat(), legs.frames)
        chunks = chunks_of(pose)
        lap("hands")
        return chunks

    def replay(self, motion: Motion, options: MotionOptions = FREE) -> Motion:
        """A finished motion through the stages, chunk by chunk, as a session of its own."""
        features = to_features(self.skeleton, motion.matrices(), torch.from_numpy(motion.root))
        state = self.init_state(1)
        everyone = torch.ones(1, dtype=torch.bool)
        state.modes.choose(everyone, options)
        padded = torch.cat([features, features[-1:].expand(-len(features) % CHUNK_FRAMES, -1)])
        pieces: tuple[Tensor, ...] = padded[None].tensor_split(len(padded) // CHUNK_FRAMES, 1)
        chunks = [self.step(piece, state, everyone, _no_lap)[0] for piece in pieces]
        rotations, root = (np.concatenate([chunk[i] for chunk in chunks]) for i in range(2))
        root[:, [0, 2]] += motion.root[0, [0, 2]]
        return replace(motion, rotations=rotations[: motion.frames], root=root[: motion.frames])

    def pose_of(
        self, features: Float[Tensor, "b t c"], state: PostState, fps: float = FRAME_RATE_HZ
    ) -> PoseLanes:
        """Rotations, and travel as decoded; what cannot be a rotation is repaired and counted in `repaired`."""
        columns = features.permute(2, 1, 0).contiguous().numpy()
        with np.errstate(invalid="ignore", over="ignore"):
            turns = lanes.from_two_rows(columns[self._rows])
        travel = columns[self._travel][[0, 2, 1]]
        if self._moving is not None:
            still = np.zeros((4, self.skeleton.joints, *turns.shape[2:]), np.float32)
            still[0], still[:, self._moving] = 1, turns
            turns = still
        pose = PoseLanes(turns, travel, fps)
        if count := repair(pose, state.calm.shown.numpy(), float(self.skeleton.rest_positions[0, 1])):
            self.repaired += count
            _log.warning("%d rotations or root positions of a chunk were not usable and were held", count)
        return pose

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


def _no_lap(stage: str) -> None:
    del stage
