"""Motion options of a session: a leash, staying in place, moving the upper body only."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field

from echoavatar.config import Config
from echoavatar.nn import StreamState

from ..kinematics import Skeleton
from .pose import Array, Pose

STAND_LOWER = 0.012  # metres by which idle hips are lowered, so that knees are not locked
SWAY = 0.008  # metres to either side
SWAY_SECONDS = (7.3, 11.9)  # periods along x and z, chosen so that they do not repeat together
RAMP_FRAMES = 32  # until the sway has its full size


class MotionOptions(Config):
    """How one session's body moves. Feet do not slide: they are held in place, or step."""

    leash_m: float = Field(
        default=0.0, ge=0, le=100, description="metres the hips may be from where they started; 0: no leash"
    )
    in_place: bool = Field(default=False, description="hips stay over the start, as game engines expect of a clip")
    upper_body: bool = Field(default=False, description="hips and legs stand idle, everything above moves")
    liveliness: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="how much a speaker gestures: 0 hardly, 1 a storyteller; None: as the seed",
    )
    handedness: float | None = Field(
        default=None, ge=0, le=1, description="the hand that gestures more: 0 left, 1 right; None: as the seed"
    )
    eye_contact: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="share of the time in which the eyes meet the viewer while the avatar speaks; half as much again"
        " while it listens",
    )
    feeling: float = Field(
        default=0.8, ge=0, le=1, description="how far the face shows what the voice feels: 0 not, 1 as much as a mood"
    )


FREE = MotionOptions()


@dataclass
class ModesState(StreamState):
    """Each row's options (leash in metres, in place, upper body as 0 or 1), and how many frames its legs have idled.

    The count of frames restarts after a whole period of the sway, because float32 counts frames for some days only.
    """

    options: Float[Array, "b 3"]
    frames: Float[Array, " b"]

    def choose(self, rows: Bool[Array, " b"], options: MotionOptions) -> None:
        """Set the options of these rows from the next chunk on."""
        self.options[rows] = options.leash_m, options.in_place, options.upper_body


class IdleLegs:
    """Legs of the upper-body mode: hips and legs stand and sway by millimetres; the rest moves as decoded."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._lower = np.array(skeleton.config.parts.get("lower", ()), np.int64)
        self._height = float(skeleton.rest_positions[0, 1]) - STAND_LOWER

    def init_state(self, rows: int) -> ModesState:
        """No row has restrictions."""
        return ModesState(np.zeros((rows, 3), np.float32), np.zeros(rows, np.float32))

    def stand(self, pose: Pose, rows: Bool[Array, " b"]) -> None:
        """Set hips and legs of these rows to rest. Call it before forward kinematics."""
        for row in np.flatnonzero(rows):
            pose.rotations[row][:, self._lower] = (1, 0, 0, 0)

    def sway(self, pose: Pose, rows: Bool[Array, " b"], state: ModesState, active: Bool[Array, " b"]) -> None:
        """Set the root of these rows to the sway. Call it before the feet are held."""
        if not rows.any():
            return
        frame = state.frames[:, None] + np.arange(1, pose.frames + 1, dtype=np.float32)
        ramp = np.minimum(frame / RAMP_FRAMES, 1)
        for axis, seconds in zip((0, 2), SWAY_SECONDS, strict=True):
            swing = SWAY * ramp * np.sin(2 * math.pi * frame / (seconds * pose.fps))
            pose.root[rows, :, axis] = swing[rows]
        pose.root[rows, :, 1] = self._height
        last, period = frame[:, -1], math.lcm(*(round(seconds * pose.fps) for seconds in SWAY_SECONDS))
        last = np.where(last >= RAMP_FRAMES + period, last - period, last)
        state.frames[active] = np.where(rows, last, 0)[active]
