"""Finds hands that are not worth learning from, and gives them new fingers (paper, Motion Refinement).

The paper finds that much of Motorica has static or erratic fingers. Static fingers hardly turn. Erratic fingers tremble
(from frame to frame, the angular velocity changes by about its own size) or bend further than fingers can. Each hand is
judged over the whole clip, at 30 frames per second.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.models.fingers import FingerModel, load_shipped, refine_fingers
from echoavatar.models.fingers.clips import FROZEN_DEG_S
from echoavatar.models.fingers.refine import finger_joints
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rotations import angle_between, axis_angle_from_quaternion, quaternion_from_matrix

State = Literal["good", "static", "erratic", "none"]
TREMBLE = 0.6  # between recorded hands (up to 0.4) and white noise (0.77 and more)
TREMBLE_DEG_S = 20.0  # slower trembling is not visible
MOST_BENT_DEG = 140.0  # more than recorded fingers ever bend


class HandScores(NamedTuple):
    """How the fingers of one hand move."""

    speed_deg_s: float  # mean over bones and frames
    tremble: float  # relative change of angular velocity between frames: 0 steady, about 0.87 white noise
    bend_deg: float  # 99th percentile of the angle from rest

    @property
    def state(self) -> State:
        """The state that these scores mean."""
        if self.speed_deg_s < FROZEN_DEG_S:
            return "static"
        trembles = self.tremble > TREMBLE and self.speed_deg_s > TREMBLE_DEG_S
        return "erratic" if trembles or self.bend_deg > MOST_BENT_DEG else "good"


def hand_states(motion: Motion) -> dict[str, State]:
    """State of the left and right hand; "none" if the rig has no finger bones."""
    rotations, states = motion.matrices(), {}
    for side in ("left", "right"):
        joints = list(finger_joints(motion, side).values())
        states[side] = hand_scores(rotations[:, joints], motion.fps).state if joints else "none"
    return states


def hand_scores(rotations: Float[Tensor, "t j 3 3"], fps: float) -> HandScores:
    """Scores of the finger bones of one hand."""
    bend = torch.rad2deg(angle_between(rotations, torch.eye(3).expand_as(rotations)))
    step = axis_angle_from_quaternion(quaternion_from_matrix(rotations[:-1].transpose(-1, -2) @ rotations[1:]))
    speed, change = step.norm(dim=-1), (step[1:] - step[:-1]).norm(dim=-1)
    both = (speed[1:] + speed[:-1]).sum() if len(speed) > 1 else torch.zeros(())
    return HandScores(
        speed_deg_s=float(torch.rad2deg(speed).mean() * fps) if len(speed) else 0.0,
        tremble=float(change.sum() / both) if both > 0 else 0.0,
        bend_deg=float(np.percentile(bend.numpy(), 99)),
    )


def mend_hands(motion: Motion, states: dict[str, State], seed: int, *, is_all: bool) -> tuple[Motion, list[str]]:
    """Give new fingers to static and erratic hands, or to all; return the motion and the sides that changed."""
    sides = [side for side, state in states.items() if state != "none" and (is_all or state != "good")]
    for side in sides if len(sides) == 1 else ():
        hands: Literal["left", "right"] = "left" if side == "left" else "right"
        return refine_fingers(_model(), motion, hands=hands, seed=seed), sides
    return (refine_fingers(_model(), motion, hands="both", seed=seed) if sides else motion), sides


@lru_cache(maxsize=1)
def _model() -> FingerModel:
    return load_shipped()
