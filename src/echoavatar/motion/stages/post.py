"""The stages between the tokenizer's decoder and the session (paper, Post-Processing).

Each stage is one compiled loop over sessions, joints and frames (`nn.kernels`). All stages share one forward
kinematics in the root's frame. Every stage but the first can be left out by name. Invalid rotations are repaired
(`repair`), counted in `repaired` and logged.
"""

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from echoavatar.errors import EchoAvatarError
from echoavatar.nn import StreamState
from echoavatar.timing import FRAME_RATE_HZ

from ..ik import BodyProfile, HandCollisions
from ..kinematics import Skeleton
from ..motion_chunk import MotionBatch
from .feet import LARGEST, LARGEST_ON_LEASH, Feet, FeetState
from .ground import Ground, GroundState
from .leash import Leash, LeashState
from .modes import IdleLegs, ModesState
from .pose import Pose, Unpacking, repair
from .smoother import SHOWN, Smoother, SmootherState, SpeedLimit, SpeedLimitState
from .stillness import Stillness, StillnessState

OnStage = Callable[[str], None]
POST_STAGES = ("pose", "smoother", "stillness", "ground", "leash", "feet", "hands")
SWITCHES = POST_STAGES[1:]
_log = logging.getLogger(__name__)


@dataclass
class PostState(StreamState):
    """The states of the stages."""

    modes: ModesState
    smoother: SmootherState
    stillness: StillnessState
    ground: GroundState
    leash: LeashState
    feet: FeetState
    limit: SpeedLimitState


class Post:
    """The stages in order: pose, smoother, stillness, ground, leash, feet, hands (with a speed limit behind them)."""

    def __init__(
        self, skeleton: Skeleton, *, stages: Collection[str] = SWITCHES, body: BodyProfile | None = None
    ) -> None:
        """`stages` names the stages to run; `body` is the character's thickness (`echoavatar rig`); None scales ours.

        Raises EchoAvatarError if there is no stage of that name.
        """
        refuse_unknown(stages, SWITCHES)
        self.skeleton, self.stages, self.repaired = skeleton, frozenset(stages), 0
        self._hands = HandCollisions(skeleton, body)
        self._chains = self._hands.chains
        self._unpacking = Unpacking(skeleton)
        self._smoother = Smoother(skeleton.joints)
        self._stillness = Stillness(skeleton)
        self._idle_legs = IdleLegs(skeleton)
        self._ground = Ground(skeleton, self._chains, is_holding="ground" in stages)
        self._leash = Leash()
        self._feet = Feet(skeleton, self._chains)
        self._limit = SpeedLimit(skeleton.joints)

    def init_state(self, rows: int) -> PostState:
        """No row has shown a frame, and none has restrictions."""
        return PostState(
            self._idle_legs.init_state(rows),
            self._smoother.init_state(rows),
            self._stillness.init_state(rows),
            self._ground.init_state(rows),
            self._leash.init_state(rows),
            self._feet.init_state(rows),
            self._limit.init_state(rows),
        )

    def step(
        self,
        features: Float[np.ndarray, "b t c"],
        state: PostState,
        active: Bool[np.ndarray, " b"],
        on_stage: OnStage | None = None,
        hands: Float[np.ndarray, "b 3"] | None = None,
    ) -> MotionBatch:
        """The motion of a chunk. `on_stage(name)` is called after each stage, also after those left out.

        `hands`: sizes of the left and the right arm's moves, and 1 where the speaker talks; see `stillness.WHOLE`.
        """
        report = on_stage or _ignore
        radius, in_place, upper_body = state.modes.options.T
        is_pinned, is_idle = in_place > 0, upper_body > 0
        is_bound = (radius > 0) | is_pinned
        pose = self.pose_of(features, state)
        report("pose")
        if "smoother" in self.stages:
            self._smoother.step(pose, state.smoother, active)
        report("smoother")
        if "stillness" in self.stages:
            self._stillness.step(pose, state.stillness, active, hands, is_idle)
        report("stillness")
        self._idle_legs.stand(pose, is_idle)
        chains = self._chains.pose(pose.rotations)
        self._ground.step(pose, chains, state.ground, active)
        self._idle_legs.sway(pose, is_idle, state.modes, active)
        report("ground")
        decoded_root, largest = pose.root, np.full(len(active), LARGEST)
        if "leash" in self.stages and is_bound.any():
            decoded_root, lean = pose.root.copy(), state.feet.lean()
            self._leash.step(pose, state.leash, active, radius=radius, is_pinned=is_pinned, lean=lean)
            largest[is_bound] = LARGEST_ON_LEASH
        report("leash")
        if "feet" in self.stages:
            self._feet.step(pose, chains, state.feet, active, decoded_root=decoded_root, largest=largest)
        report("feet")
        if "hands" in self.stages:
            self._hands.resolve(pose.rotations, chains)
            self._limit.step(pose, state.limit, active)
        np.negative(pose.rotations, out=pose.rotations, where=pose.rotations[..., :1] < 0)
        report("hands")
        return MotionBatch(pose.rotations, pose.root)

    def pose_of(self, features: Float[np.ndarray, "b t c"], state: PostState) -> Pose:
        """Rotations, and travel as decoded; invalid rotations are repaired and counted in `repaired`."""
        pose, is_good = self._unpacking.pose_of(features, FRAME_RATE_HZ)
        if not is_good:
            standing = float(self.skeleton.rest_positions[0, 1])
            count = repair(pose, state.smoother.rotations[:, SHOWN - 1], standing)
            self.repaired += count
            _log.warning("%d rotations or root positions of a chunk were invalid and were held", count)
        return pose


def refuse_unknown(stages: Collection[str], known: Sequence[str]) -> None:
    """Raise EchoAvatarError where `stages` names one that is not in `known`."""
    if unknown := sorted(set(stages).difference(known)):
        raise EchoAvatarError(f"no stage {unknown[0]!r} to switch on or off; there are {', '.join(known)}")


def _ignore(stage: str) -> None:
    del stage
