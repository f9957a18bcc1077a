"""Which hands of a recording are not worth learning from, and new fingers for them (paper, Motion Refinement).

The paper finds that much of Motorica has static or erratic fingers. Static: they hardly turn. Erratic: they tremble
(the angular velocity changes from frame to frame about as much as it is) or bend as no finger does. Judged per hand
over the whole clip, at 30 frames per second.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ..fingers import FingerModel, load_shipped, refine_fingers
from ..fingers.clips import FROZEN_DEG_S
from ..fingers.finger_retarget import finger_joints
from ..kinematics import Motion
from ..kinematics.rotations import angle_between, axis_angle_from_quaternion, quaternion_from_matrix

State = Literal["good", "static", "erratic", "none"]
TREMBLE = 0.6  # recorded hands score 0.02 to 0.4, white noise on top of them 0.77 to 0.9
TREMBLE_DEG_S = 20.0  # slower trembling is not seen
MOST_BENT_DEG = 140.0  # recorded finger bones stay under 115 for 99 % of the time


class HandScores(NamedTuple):
    """How the fingers of one hand move."""

    speed_deg_s: float  # mean over bones and frames
    tremble: (
        float  # change of angular velocity between frames, over its size; 0 steady, about 0.87 white noise
    )
    bend_deg: float  # 99th percentile of the angle from rest

    @property
    def state(self) -> State:
        """What that says of the hand."""
        if self.speed_deg_s < FROZEN_DEG_S:
            return "static"
        trembles = self.tremble > TREMBLE and self.speed_deg_s > TREMBLE_DEG_S
        return "erratic" if trembles or self.bend_deg > MOST_BENT_DEG else "good"


def hand_states(motion: Motion) -> dict[str, State]:
    """State of the left and right hand; "none" where the rig has no finger bones."""
    turns, states = motion.matrices(), {}
    for side in ("left", "right"):
        joints = list(finger_joints(motion, side).values())
        states[side] = hand_scores(turns[:, joints], motion.fps).state if joints else "none"
    return states


def hand_scores(turns: Float[Tensor, "t j 3 3"], fps: float) -> HandScores:
    """Scores of the finger bones of one hand."""
    bend = torch.rad2deg(angle_between(turns, torch.eye(3).expand_as(turns)))
    step = axis_angle_from_quaternion(quaternion_from_matrix(turns[:-1].transpose(-1, -2) @ turns[1:]))
    speed, change = step.norm(dim=-1), (step[1:] - step[:-1]).norm(dim=-1)
    both = (speed[1:] + speed[:-1]).sum() if len(speed) > 1 else torch.zeros(())
    return HandScores(
        speed_deg_s=float(torch.rad2deg(speed).mean() * fps) if len(speed) else 0.0,
        tremble=float(change.sum() / both) if both > 0 else 0.0,
        bend_deg=float(np.percentile(bend.numpy(), 99)),
    )


def mend_hands(
    motion: Motion, states: dict[str, State], seed: int, *, is_all: bool
) -> tuple[Motion, list[str]]:
    """New fingers for hands that are static or erratic, or for all; and which sides got them."""
    sides = [side for side, state in states.items() if state != "none" and (is_all or state != "good")]
    for side in sides if len(sides) == 1 else ():
        hands: Literal["left", "right"] = "left" if side == "left" else "right"
        return refine_fingers(_model(), motion, hands=hands, seed=seed), sides
    return (refine_fingers(_model(), motion, hands="both", seed=seed) if sides else motion), sides


@lru_cache(maxsize=1)
def _model() -> FingerModel:
    return load_shipped()
