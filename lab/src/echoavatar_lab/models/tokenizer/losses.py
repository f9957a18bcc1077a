"""Training losses (paper, appendix Auxiliary Loss Functions): features, commitment, and forward kinematics.

All three parts are decoded first and share one forward kinematics, so every part is judged by the joint positions of
the whole decoded body. Lengths are in centimetres, since the paper gives its weights no unit. The root has its own
height, in the paper at a constant place; the foot terms are of ankles and toes, since no rig of ours has heels.

Our additions, zero in the paper recipe: `travel`, the drift of the integrated root path over the window; `planted`, the
world velocity of feet that stand still in the data (planted feet must not skate); `fingers`, finger joints seen
relative to the wrist, so that errors of the arm do not hide theirs; `root`, an extra weight on the
three travel features, which are 3 of 57 channels but move the whole body; `turn`, how far the shoulders turn against
the hips. The other terms ask for the likeliest motion, which is smaller than people's where codes leave it open.

`PlaneKinematics` goes from features straight to joint positions. The arithmetic is that of
`kinematics.forward_kinematics` (paper, appendix Forward Kinematics), but every component of a matrix is a plane of
joints by frames, so that the processor multiplies long rows instead of many small matrices: much faster on a CPU,
gradient included.
"""

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.features import travel_slice


class PlaneKinematics(nn.Module):
    """Joint positions (axis, joint, row, frame) of features, the root standing above the origin at its height."""

    source: Tensor
    offsets: Tensor
    back: Tensor

    def __init__(self, skeleton: Skeleton) -> None:
        super().__init__()
        joints = list(skeleton.feature_joints)
        if sorted(joints) != list(range(skeleton.joints)):
            raise ValueError("every joint must belong to a body part")
        levels = [[0], *(level.joints for level in skeleton.levels)]
        order = [joint for level in levels for joint in level]
        travel = travel_slice(skeleton)
        columns = [c for c in range(6 * len(joints) + 3) if not travel.start <= c < travel.stop]
        source = [columns[6 * joints.index(joint) + c] for c in range(6) for joint in order]
        self.height = travel.stop - 1
        self.sizes = [len(level) for level in levels]
        self.parents = [
            [above.index(parent) for parent in level.parents]
            for above, level in zip(levels, skeleton.levels, strict=False)
        ]
        back = torch.tensor([order.index(joint) for joint in range(skeleton.joints)])
        self.register_buffer("source", torch.tensor(source), persistent=False)
        self.register_buffer(
            "offsets", torch.from_numpy(skeleton.offsets[order]).T[:, :, None].clone(), persistent=False
        )
        self.register_buffer("back", back, persistent=False)

    def forward(self, features: Float[Tensor, "b t c"]) -> Float[Tensor, "3 j b t"]:
        """Positions in metres; features not normalised."""
        b, t, _ = features.shape
        flat = features.reshape(b * t, -1).T
        first, second = flat.index_select(0, self.source).view(2, 3, -1, b * t).unbind(0)
        x = _unit(first)
        y = _unit(second - (x * second).sum(0) * x)
        x0, x1, x2 = x.unbind(0)
        y0, y1, y2 = y.unbind(0)
        z = torch.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0])
        rows = [torch.split(row, self.sizes, 1) for row in (x, y, z)]
        places = self._descend(rows, flat[self.height])
        return torch.cat(places, 1).index_select(1, self.back).view(3, -1, b, t)

    def _descend(self, rows: list[tuple[Tensor, ...]], height: Tensor) -> list[Tensor]:
        """Level by level down the tree; `world` holds global matrices column by column: (row, joint, frame)."""
        world = torch.stack([row[0] for row in rows], 1).unbind(0)
        zero = torch.zeros_like(height)
        places = [torch.stack([zero, height, zero])[:, None]]
        offsets = torch.split(self.offsets, self.sizes, 1)
        for depth, parents in enumerate(self.parents, start=1):
            chosen = torch.tensor(parents, device=height.device)
            a, b, c = (column.index_select(1, chosen) for column in world)
            u, v, w = offsets[depth]
            places.append(places[-1].index_select(1, chosen) + a * u + b * v + c * w)
            if depth < len(self.parents):
                lines = [row[depth].unbind(0) for row in rows]
                world = tuple(a * x + b * y + c * z for x, y, z in zip(*lines, strict=True))
        return places


def _unit(vector: Tensor) -> Tensor:
    """Planes (axis, joint, frame) of length one."""
    x, y, z = vector.unbind(0)
    return vector * (x * x + y * y + z * z).clamp_min(1e-16).rsqrt()


def turning_joints(skeleton: Skeleton) -> list[int]:
    """Left and right shoulder joint, left and right hip joint. Raises ValueError if the VRM map lacks one."""
    bones = [side + bone for bone in ("UpperArm", "UpperLeg") for side in ("left", "right")]
    if missing := [bone for bone in bones if bone not in skeleton.config.vrm]:
        raise ValueError(f"the skeleton's VRM map lacks {', '.join(missing)}, which the loss `turn` needs")
    return [skeleton.config.vrm[bone] for bone in bones]


def shoulder_turn_deg(joints: Float[Tensor, "3 4 b t"]) -> Float[Tensor, "b t"]:
    """The angle about the vertical from the line through the hip joints to that through the shoulders."""
    shoulders, hips = joints[:, 0] - joints[:, 1], joints[:, 2] - joints[:, 3]
    across = hips[2] * shoulders[0] - hips[0] * shoulders[2]
    return torch.rad2deg(torch.atan2(across, hips[0] * shoulders[0] + hips[2] * shoulders[2]))


def finger_joints(skeleton: Skeleton) -> list[int]:
    """The part `hands`; where the body is one part, every joint below a hand of the VRM map."""
    if "hands" in skeleton.config.parts:
        return list(skeleton.config.parts["hands"])
    wrists = {skeleton.config.vrm[name] for name in ("leftHand", "rightHand") if name in skeleton.config.vrm}
    below: list[int] = []
    for joint, parent in enumerate(skeleton.parents):
        if parent in wrists or parent in below:
            below.append(joint)
    return below


def wrist_of(skeleton: Skeleton, joint: int) -> int:
    """The first ancestor of a joint outside the hands."""
    fingers = finger_joints(skeleton)
    while joint in fingers:
        joint = skeleton.parents[joint]
    return joint


CENTIMETRES = 100.0
PLANTED_BELOW = 0.2  # cm per frame (6 cm/s): a foot slower than this in the data stands still


class LossWeights(Config):
    """Weight of each term, lengths in centimetres; defaults are the paper's numbers, which have no unit there."""

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
        self.travel = travel_slice(skeleton)

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
