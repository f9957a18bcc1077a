"""From decoded features to a pose that holds together: calm, ground, leash, feet, hands (paper, Post-Processing).

Every stage is one compiled loop over sessions, eight frames at once (`nn.octet`); what few sessions ask for (a leash,
idle legs, repair) is plain numpy. One forward kinematics in the root's frame serves all stages. Every stage but the
first can be left out by name. Rotations that are not finite, or from which no rotation can be made, are repaired
(`repair`), reported by `repaired` and in the log.
"""

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..errors import EchoAvatarError
from ..ik import BodyProfile, HandGuard
from ..ik.chains import Chains
from ..kinematics import Motion, Skeleton, to_features
from ..nn import StreamState
from ..timing import CHUNK_FRAMES, FRAME_RATE_HZ
from .calm import Calm, CalmState
from .crowd import MANY, Crowd
from .feet import LARGEST, Feet, FeetState
from .ground import Ground, GroundState
from .leash import Leash, LeashState
from .modes import FREE, IdleLegs, ModesState, MotionOptions
from .motion_chunk import MotionBatch, in_a_row
from .pose import PoseLanes
from .repair import repair
from .unpack import Unpacking, frames_of

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
        refuse_unknown(stages, SWITCHES)
        self.skeleton, self.stages, self.repaired = skeleton, frozenset(stages), 0
        self.hands = HandGuard(skeleton, body)
        feet = skeleton.config.feet
        self.chains = Chains(skeleton, [0, *self.hands.joints, *feet])
        self.hands.stand_on(self.chains)
        self.calm = Calm(skeleton.joints)
        self.ground = Ground(skeleton, self.chains, is_holding="ground" in stages)
        self.leash, self.idle = Leash(), IdleLegs(skeleton)
        self.feet = Feet(skeleton, self.chains)
        self._unpacking = Unpacking(skeleton)
        is_whole = self.stages == frozenset(SWITCHES) and self.hands.is_able and self.feet.is_able
        self._crowd: Crowd | None = None
        if is_whole:
            self._crowd = Crowd(self._unpacking, self.chains, self.calm, self.ground, self.feet, self.hands)

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
        lap: Lap | None = None,
    ) -> MotionBatch:
        """Motion of a chunk (at most 8 frames); after each stage `lap(stage)` is called, also after those left out.

        Without a `lap` large batches go another way, to the same numbers: through all stages session by session.
        """
        if self._crowd is None or lap is not None or len(features) < MANY:
            return self._step(features, state, active, lap or _no_lap)
        given = np.ascontiguousarray(features.numpy())
        options, states = state.modes.options.numpy(), (state.calm, state.ground, state.feet)
        shown, done = self._crowd.step(given, FRAME_RATE_HZ, options, states, active.numpy())
        if done < len(given):
            left = slice(done, None)
            rest = self._step(features[left], state.rows(left), active[left], _no_lap)
            shown.rotations[left], shown.root[left] = rest
        return shown

    def _step(self, features: Tensor, state: PostState, active: Tensor, lap: Lap) -> MotionBatch:
        on = active.numpy()
        pose = self.pose_of(features, state)
        lap("pose")
        if "calm" in self.stages:
            self.calm.step(pose, state.calm, on)
        lap("calm")
        leash, is_pinned, is_idle = state.modes.options.numpy().T > 0
        if is_idle.any():
            self.idle.stand(pose, is_idle)
        frames = self.chains.world(pose.turns)
        self.ground.step(pose, frames, state.ground, on)
        if is_idle.any():
            self.idle.sway(pose, is_idle, state.modes, on)
        lap("ground")
        largest = decoded_root = None
        if "leash" in self.stages and (leash | is_pinned).any():
            radius, lean, decoded_root = (
                state.modes.options.numpy()[:, 0],
                state.feet.lean(),
                pose.root.copy(),
            )
            self.leash.step(pose, state.leash, on, radius=radius, is_pinned=is_pinned, lean=lean)
            largest = np.where(leash | is_pinned, LARGEST_ON_LEASH, LARGEST)
        lap("leash")
        if "feet" in self.stages:
            self.feet.step(pose, frames, state.feet, on, decoded_root=decoded_root, largest=largest)
        lap("feet")
        if "hands" in self.stages:
            self.hands.guard(pose.turns, frames)
        shown = MotionBatch(*frames_of(pose))
        lap("hands")
        return shown

    def replay(self, motion: Motion, options: MotionOptions = FREE) -> Motion:
        """A finished motion through the stages, chunk by chunk, as a session of its own."""
        features = to_features(self.skeleton, motion.matrices(), torch.from_numpy(motion.root))
        state = self.init_state(1)
        everyone = torch.ones(1, dtype=torch.bool)
        state.modes.choose(everyone, options)
        padded = torch.cat([features, features[-1:].expand(-len(features) % CHUNK_FRAMES, -1)])
        pieces: tuple[Tensor, ...] = padded[None].tensor_split(len(padded) // CHUNK_FRAMES, 1)
        shown = in_a_row([self.step(piece, state, everyone) for piece in pieces])
        rotations, root = shown.rotations[0], shown.root[0]
        root[:, [0, 2]] += motion.root[0, [0, 2]]
        return replace(motion, rotations=rotations[: motion.frames], root=root[: motion.frames])

    def pose_of(
        self, features: Float[Tensor, "b t c"], state: PostState, fps: float = FRAME_RATE_HZ
    ) -> PoseLanes:
        """Rotations, and travel as decoded; what cannot be a rotation is repaired and counted in `repaired`."""
        pose, is_good = self._unpacking.pose_of(features.numpy(), fps)
        if not is_good:
            standing = float(self.skeleton.rest_positions[0, 1])
            count = repair(pose, state.calm.shown.numpy(), standing)
            self.repaired += count
            _log.warning("%d rotations or root positions of a chunk were not usable and were held", count)
        return pose


def refuse_unknown(stages: Collection[str], known: Sequence[str]) -> None:
    """Raise EchoAvatarError where `stages` names one that is not in `known`."""
    if unknown := sorted(set(stages).difference(known)):
        raise EchoAvatarError(f"no stage {unknown[0]!r} to switch on or off; there are {', '.join(known)}")


def _no_lap(stage: str) -> None:
    del stage
