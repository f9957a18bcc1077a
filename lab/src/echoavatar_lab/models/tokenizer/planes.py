"""Forward kinematics for training, from features straight to joint positions, laid out in planes.

The same arithmetic as `kinematics.forward_kinematics` (paper, appendix Forward Kinematics), but every component of
a matrix is a plane of joints by frames, so that the processor multiplies long rows instead of many small matrices:
much faster on a CPU, gradient included.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.motion.kinematics import Skeleton, part_sizes

TRAVEL_SIZE = 3  # two velocities and the height, at the end of the first part


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
        order = [joint for level in skeleton.levels for joint in level]
        travel = travel_columns(skeleton)
        columns = [c for c in range(6 * len(joints) + 3) if not travel.start <= c < travel.stop]
        source = [columns[6 * joints.index(joint) + c] for c in range(6) for joint in order]
        self.height = travel.stop - 1
        self.sizes = [len(level) for level in skeleton.levels]
        self.parents = [
            [skeleton.levels[depth].index(skeleton.parents[joint]) for joint in level]
            for depth, level in enumerate(skeleton.levels[1:])
        ]
        back = torch.tensor([order.index(joint) for joint in range(skeleton.joints)])
        self.register_buffer("source", torch.tensor(source), persistent=False)
        self.register_buffer("offsets", skeleton.offsets[order].T[:, :, None].clone(), persistent=False)
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


def travel_columns(skeleton: Skeleton) -> slice:
    """Columns of the root's two velocities and its height."""
    end = next(iter(part_sizes(skeleton).values()))
    return slice(end - TRAVEL_SIZE, end)


def turning_joints(skeleton: Skeleton) -> list[int]:
    """Left and right shoulder joint, left and right hip joint.

    Raises:
        ValueError: the VRM map lacks one.
    """
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
