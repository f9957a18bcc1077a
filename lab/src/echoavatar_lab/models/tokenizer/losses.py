"""Training losses (paper, appendix Auxiliary Loss Functions): features, commitment, and forward kinematics.

All three parts are decoded first and share one forward kinematics, so every part is judged by the joint positions of
the whole decoded body. The paper's weights are for centimetres; so are ours.

Our additions, zero in the paper recipe: `travel`, the drift of the integrated root path over the window; `planted`, the
world velocity of feet that stand still in the data (planted feet must not skate); `fingers`, finger joints seen
relative to the wrist, so that errors of the arm do not hide theirs; `root`, an extra weight on the
three travel features, which are 3 of 57 channels but move the whole body; `turn`, how far the shoulders turn against
the hips. The other terms ask for the likeliest motion, which is smaller than people's where codes leave it open.
"""

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.motion.kinematics import Skeleton

from .planes import PlaneKinematics, finger_joints, shoulder_turn_deg, travel_columns, turning_joints, wrist_of

CENTIMETRES = 100.0
PLANTED_BELOW = 0.2  # cm per frame (6 cm/s): a foot slower than this in the data stands still


class LossWeights(Config):
    """Weight of each term; defaults are the paper's, lengths in centimetres."""

    commitment: float = Field(default=0.5, ge=0, description="distance of latents to their codes (eta)")
    position: float = Field(default=0.02, ge=0, description="joint positions")
    velocity: float = Field(default=0.2, ge=0, description="first differences of joint positions")
    acceleration: float = Field(default=0.2, ge=0, description="second differences of joint positions")
    foot_velocity: float = Field(default=0.3, ge=0, description="first differences of ankles and toes")
    foot_position: float = Field(default=0.05, ge=0, description="positions of ankles and toes")
    travel: float = Field(default=0.0, ge=0, description="ours: drift of the integrated root path")
    planted: float = Field(default=0.0, ge=0, description="ours: world velocity of standing feet")
    fingers: float = Field(default=0.0, ge=0, description="ours: finger joints as seen from their wrist")
    root: float = Field(default=0.0, ge=0, description="ours: extra weight of the travel features")
    turn: float = Field(default=0.0, ge=0, description="ours: deviation of the shoulders' turn in a window, degrees")


class MotionLoss(nn.Module):
    """Reconstruction and kinematic terms between decoded and true features."""

    def __init__(self, skeleton: Skeleton, weights: LossWeights) -> None:
        super().__init__()
        if not skeleton.config.feet:
            raise ValueError("the skeleton names no feet, which the foot losses need")
        self.weights = weights
        self.kinematics = PlaneKinematics(skeleton)
        self.feet = list(skeleton.config.feet)
        self.fingers = finger_joints(skeleton)
        self.wrists = [wrist_of(skeleton, joint) for joint in self.fingers]
        self.turning = turning_joints(skeleton) if weights.turn else []
        self.travel = travel_columns(skeleton)

    def forward(
        self,
        decoded: Float[Tensor, "b t c"],
        truth: Float[Tensor, "b t c"],
        *,
        mean: Float[Tensor, " c"],
        std: Float[Tensor, " c"],
    ) -> dict[str, Float[Tensor, ""]]:
        """Every weighted term by name, of normalised features; the RVQ adds its commitment."""
        w = self.weights
        terms = {"features": (decoded - truth).abs().mean()}
        if w.root:
            terms["root"] = w.root * (decoded - truth)[..., self.travel].abs().mean()
        ours, theirs = decoded * std + mean, truth * std + mean
        with torch.no_grad():
            wanted = self.kinematics(theirs) * CENTIMETRES
        places = self.kinematics(ours) * CENTIMETRES
        error = places - wanted
        terms.update(self._kinematic(error))
        if w.turn:
            size, wanted_size = (shoulder_turn_deg(where[:, self.turning]).std(-1) for where in (places, wanted))
            terms["turn"] = w.turn * (size - wanted_size).abs().mean()
        if w.travel or w.planted:
            terms.update(self._ground(error, wanted, ours, theirs))
        return terms

    def _kinematic(self, error: Tensor) -> dict[str, Tensor]:
        """Every paper term is linear in positions, so differences of the error are errors of differences."""
        w = self.weights
        velocity = error.diff(dim=-1)
        feet = error[:, self.feet]
        terms = {
            "position": w.position * error.abs().mean(),
            "velocity": w.velocity * velocity.abs().mean(),
            "acceleration": w.acceleration * velocity.diff(dim=-1).abs().mean(),
            "foot_velocity": w.foot_velocity * feet.diff(dim=-1).abs().mean(),
            "foot_position": w.foot_position * feet.abs().mean(),
        }
        if w.fingers:
            seen = error[:, self.fingers] - error[:, self.wrists]
            terms["fingers"] = w.fingers * seen.abs().mean()
        return terms

    def _ground(self, error: Tensor, wanted: Tensor, ours: Tensor, theirs: Tensor) -> dict[str, Tensor]:
        w, x = self.weights, self.travel.start
        truth = theirs[..., x : x + 2].permute(2, 0, 1) * CENTIMETRES  # axis b t
        drift = ours[..., x : x + 2].permute(2, 0, 1) * CENTIMETRES - truth
        ground = [0, 2]
        steps = wanted[ground][:, self.feet].diff(dim=-1) + truth[:, None, :, 1:]
        is_planted = (steps.square().sum(0) < PLANTED_BELOW**2).to(error)
        slip = error[ground][:, self.feet].diff(dim=-1) + drift[:, None, :, 1:]
        return {
            "travel": w.travel * drift.cumsum(-1).abs().mean(),
            "planted": w.planted * (slip.abs().sum(0) * is_planted).sum() / is_planted.sum().clamp_min(1),
        }


def total(terms: dict[str, Float[Tensor, ""]]) -> Float[Tensor, ""]:
    """The loss."""
    return torch.stack(list(terms.values())).sum()
