"""Controls to joint rotations: analytic limb IK, spine and neck angles shared out over their joints, finger limits.

Everything is in closed form and vectorised over frames. Both arms are solved as left arms in mirrored chest axes; the
right one is mirrored back. Reach is limited softly, so limbs never lock. Planted feet do not move: if they would be out
of reach, the pelvis sinks.
"""

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from echoavatar.motion.kinematics.skeleton import HUMANOID
from echoavatar_lab.kinematics import matrix_from_axis_angle, quaternion_from_matrix

from .controls import Controls

BLOCK_FRAMES = 8192
SPINE_SHARE = (0.30, 0.35, 0.35)
NECK_SHARE = 0.45
REACH = 0.992  # of a limb's length
SOFT_M = 0.004  # over which the pelvis begins to sink
PALM_LIMITS = ((-1.15, 1.15), (-0.55, 0.38), (-1.65, 1.55))
CURL_RANGE = (1.45, 1.70, 1.15)  # proximal, intermediate, distal, radians at curl 1
SPREAD_RANGE = (0.24, 0.05, -0.13, -0.27)  # index .. little, radians at spread 1
THUMB_CURL = (0.30, 0.75, 1.05)
FINGERS = ("Index", "Middle", "Ring", "Little")
SIDES = ("left", "right")
_EASY_REACH = torch.tensor([0.30, -0.75, 0.60], dtype=torch.float64)
_EASY_ELBOW = torch.tensor([0.40, -0.45, -0.80], dtype=torch.float64)


def solve(controls: Controls) -> tuple[Float[np.ndarray, "t 52 4"], Float[np.ndarray, "t 3"]]:
    """Parent-relative quaternions `wxyz` of our rig and the root's world position in metres."""
    blocks = [_solve_block(controls[i : i + BLOCK_FRAMES]) for i in range(0, len(controls), BLOCK_FRAMES)]
    return np.concatenate([q for q, _ in blocks]), np.concatenate([r for _, r in blocks])


def _solve_block(controls: Controls) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    local = torch.eye(3, dtype=torch.float64).repeat(len(controls), HUMANOID.joints, 1, 1)
    local[:, 0] = pelvis = matrix_from_euler(_tensor(controls.pelvis_rotation), "yxz")
    spine, head = _tensor(controls.spine), _tensor(controls.head)
    for name, share in zip(("spine", "chest", "upperChest"), SPINE_SHARE, strict=True):
        local[:, HUMANOID.index(name)] = matrix_from_euler(spine * share, "yxz")
    local[:, HUMANOID.index("neck")] = matrix_from_euler(head * NECK_SHARE, "yxz")
    local[:, HUMANOID.index("head")] = matrix_from_euler(head * (1 - NECK_SHARE), "yxz")
    root = _legs(controls, pelvis, local)
    for side in range(2):
        _arm(controls, side, local)
        _fingers(_tensor(controls.fingers[:, side]), side, local)
    return quaternion_from_matrix(local).float().numpy(), root.float().numpy()


def _legs(controls: Controls, pelvis: Tensor, local: Tensor) -> Float[Tensor, "t 3"]:
    """Write the legs' rotations; return the root, lowered where the feet would be out of reach."""
    root = _tensor(controls.pelvis_position)
    thigh, shin = offset_of("leftLowerLeg"), offset_of("leftFoot")
    longest = REACH * float(thigh.norm() + shin.norm())
    feet = [_ankle(controls, side) for side in range(2)]
    hips = [(pelvis @ offset_of(f"{side}UpperLeg")[:, None]).squeeze(-1) for side in SIDES]
    ceilings = [root[:, 1]]
    for (ankle, _), hip in zip(feet, hips, strict=True):
        away = (root + hip - ankle)[:, [0, 2]].square().sum(-1)
        ceilings.append(ankle[:, 1] + (longest**2 - away).clamp_min(0.04).sqrt() - hip[:, 1])
    lowest = -SOFT_M * torch.logsumexp(-torch.stack(ceilings) / SOFT_M, dim=0)
    root = torch.stack([root[:, 0], lowest, root[:, 2]], -1)
    for side, name in enumerate(SIDES):
        ankle, foot = feet[side]
        reach = ankle - root - hips[side]
        distance = reach.norm(dim=-1, keepdim=True)
        line = reach / distance
        yaw, swing = (_tensor(curve[:, side]) for curve in (controls.foot_yaw, controls.knee_swing))
        knee = knee_direction(line, yaw, pelvis, swing if side == 0 else -swing)
        hinge = torch.linalg.cross(knee, line)
        first, second = two_bones(line, knee, distance, float(thigh.norm()), float(shin.norm()))
        upper = _hinged(hinge, first) @ _hinged(_X, F.normalize(thigh, dim=-1)).mT
        lower = _hinged(hinge, second) @ _hinged(_X, F.normalize(shin, dim=-1)).mT
        pitch = _tensor(controls.foot_pitch[:, side])  # of a lifted heel: the toes bend as far at first, 1 at most
        local[:, HUMANOID.index(f"{name}UpperLeg")] = pelvis.mT @ upper
        local[:, HUMANOID.index(f"{name}LowerLeg")] = upper.mT @ lower
        local[:, HUMANOID.index(f"{name}Foot")] = lower.mT @ foot
        local[:, HUMANOID.index(f"{name}Toes")] = about("x", -torch.tanh(pitch.clamp_min(0.0)))
    return root


def _ankle(controls: Controls, side: int) -> tuple[Float[Tensor, "t 3"], Float[Tensor, "t 3 3"]]:
    """World position and rotation of an ankle."""
    place, pitch = _tensor(controls.foot_position[:, side]), _tensor(controls.foot_pitch[:, side])
    heading, roll = about("y", _tensor(controls.foot_yaw[:, side])), _tensor(controls.foot_roll[:, side])
    foot = heading @ about("x", pitch) @ about("z", roll if side == 0 else -roll)
    return place + raised_ankle(heading, foot, pitch), foot


def raised_ankle(
    heading: Float[Tensor, "t 3 3"], foot: Float[Tensor, "t 3 3"], pitch: Float[Tensor, " t"]
) -> Float[Tensor, "t 3"]:
    """Way of the ankle from the flat foot's to the pitched foot's; the heel lifts about the ball, the toes about it."""
    ball = offset_of("leftToes")
    heel = torch.tensor([0.0, float(ball[1]), -0.045], dtype=torch.float64)
    pivot = torch.where(pitch[:, None] > 0, ball, heel)
    return ((heading - foot) @ pivot[..., None]).squeeze(-1)


def knee_direction(
    line: Float[Tensor, "t 3"],
    foot_yaw: Float[Tensor, " t"],
    pelvis: Float[Tensor, "t 3 3"],
    swing: Float[Tensor, " t"],
) -> Float[Tensor, "t 3"]:
    """Unit vector from the hip-ankle line to the knee: between foot and pelvis, then turned towards the left."""
    foot = torch.stack([foot_yaw.sin(), torch.zeros_like(foot_yaw), foot_yaw.cos()], -1)
    knee = 0.6 * foot + 0.4 * F.normalize(pelvis[..., 2] * _FLAT, dim=-1)
    knee = F.normalize(off_line(knee, line), dim=-1)
    turned: Tensor = swing.cos()[:, None] * knee + swing.sin()[:, None] * torch.linalg.cross(knee, line)
    return turned


class ArmFrames(NamedTuple):
    """One arm as a left arm in mirrored chest axes: rotations relative to them, and positions in metres."""

    clavicle: Float[Tensor, "t 3 3"]
    upper: Float[Tensor, "t 3 3"]
    lower: Float[Tensor, "t 3 3"]
    half_turn: Float[Tensor, "t 3 3"]
    hand: Float[Tensor, "t 3 3"]
    elbow: Float[Tensor, "t 3"]
    wrist: Float[Tensor, "t 3"]


def arm_frames(controls: Controls, side: int) -> ArmFrames:
    """Solve one arm; `elbow` and `wrist` are measured from the shoulder joint."""
    lift, forward = _tensor(controls.shoulder[:, side]).clamp(-0.5, 0.7).unbind(-1)
    clavicle = about("z", lift) @ about("y", -forward)
    reach = _tensor(controls.wrist[:, side])
    upper_length, lower_length = (float(offset_of(f"left{bone}").norm()) for bone in ("LowerArm", "Hand"))
    distance = reach.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    line = reach / distance
    distance = _soft_reach(distance, upper_length + lower_length)
    elbow = elbow_direction(line, _tensor(controls.elbow_swing[:, side]))
    first, second = two_bones(line, elbow, distance, upper_length, lower_length)
    hinge = torch.linalg.cross(line, elbow)
    upper, lower = (torch.stack([bone, hinge, torch.linalg.cross(bone, hinge)], -1) for bone in (first, second))
    flex, deviation, pronation = (
        _soft_clamp(angle, *limits)
        for angle, limits in zip(_tensor(controls.palm[:, side]).unbind(-1), PALM_LIMITS, strict=True)
    )
    half = about("x", pronation / 2)
    hand = half @ about("y", -deviation) @ about("z", -flex)
    return ArmFrames(clavicle, upper, lower, half, hand, first * upper_length, distance * line)


def _arm(controls: Controls, side: int, local: Tensor) -> None:
    """Write clavicle, upper arm, forearm and hand of one side, solved as a left arm."""
    arm = arm_frames(controls, side)
    chain = {
        "Shoulder": arm.clavicle,
        "UpperArm": arm.clavicle.mT @ arm.upper,
        "LowerArm": arm.upper.mT @ arm.lower @ arm.half_turn,
        "Hand": arm.hand,
    }
    for bone, rotation in chain.items():
        local[:, HUMANOID.index(SIDES[side] + bone)] = for_side(rotation, side)


def elbow_direction(line: Float[Tensor, "t 3"], swing: Float[Tensor, " t"]) -> Float[Tensor, "t 3"]:
    """Unit vector from the shoulder-wrist line to the elbow.

    The smallest rotation carries a relaxed pose to the new line; its only singular direction is up behind the neck.
    """
    easy = F.normalize(_EASY_REACH, dim=-1)
    elbow = F.normalize(_EASY_ELBOW - (_EASY_ELBOW @ easy) * easy, dim=-1)
    cosine = (line @ easy)[:, None].clamp_min(-0.98)
    axis = torch.linalg.cross(easy.expand_as(line), line)
    along = (axis @ elbow)[:, None]
    carried = cosine * elbow + torch.linalg.cross(axis, elbow.expand_as(axis)) + axis * along / (1 + cosine)
    carried = F.normalize(off_line(carried, line), dim=-1)
    turned: Tensor = swing.cos()[:, None] * carried + swing.sin()[:, None] * torch.linalg.cross(line, carried)
    return turned


def off_line(vector: Float[Tensor, "*t 3"], line: Float[Tensor, "*t 3"]) -> Float[Tensor, "*t 3"]:
    """The part of a vector at right angles to a line, which is a unit vector."""
    return vector - (vector * line).sum(-1, keepdim=True) * line


def two_bones(
    line: Tensor, bend: Tensor, distance: Tensor, upper: float, lower: float
) -> tuple[Float[Tensor, "t 3"], Float[Tensor, "t 3"]]:
    """Directions of the two bones of a limb whose middle joint points along `bend`."""
    along = (distance.square() + upper**2 - lower**2) / (2 * distance)
    aside = (upper**2 - along.square()).clamp_min(0.0).sqrt()
    return (along * line + aside * bend) / upper, ((distance - along) * line - aside * bend) / lower


def _fingers(fingers: Float[Tensor, "t 7"], side: int, local: Tensor) -> None:
    """Write one hand's fingers: hinges across the palm, spread at the knuckles, and the thumb's own axes."""
    curl = fingers[:, :5].clamp(-0.12, 1.0)
    spread = fingers[:, 5].clamp(-1.0, 1.0)
    for i, finger in enumerate(FINGERS):
        bend = curl[:, i + 1]
        aside = about("y", -SPREAD_RANGE[i] * spread * (1 - 0.8 * bend.clamp_min(0)))
        for bone, most in zip(("Proximal", "Intermediate", "Distal"), CURL_RANGE, strict=True):
            share = bend if bone == "Proximal" else bend.clamp_min(-0.02)
            turn = about("z", -most * share)
            index = HUMANOID.index(f"{SIDES[side]}{finger}{bone}")
            local[:, index] = for_side(aside @ turn if bone == "Proximal" else turn, side)
    opposed = fingers[:, 6].clamp(0.0, 1.0)
    for bone, most in zip(("Metacarpal", "Proximal", "Distal"), THUMB_CURL, strict=True):
        turn = matrix_from_axis_angle(curl[:, :1] * most * THUMB_HINGE)
        if bone == "Metacarpal":
            away = matrix_from_axis_angle(opposed[:, None] * 0.75 * THUMB_AWAY)
            turn = away @ matrix_from_axis_angle(opposed[:, None] * 0.55 * THUMB) @ turn
        local[:, HUMANOID.index(f"{SIDES[side]}Thumb{bone}")] = for_side(turn, side)


def _soft_reach(distance: Tensor, length: float) -> Tensor:
    """Distance limited smoothly between the folded and the stretched limb."""
    least, width = 0.30 * length, 0.03 * length
    distance = least + width * F.softplus((distance - least) / width)
    easy, most = 0.94 * length, REACH * length
    far = most - (most - easy) * torch.exp(-(distance - easy).clamp_min(0) / (most - easy))
    return torch.where(distance > easy, far, distance)


def _soft_clamp(angle: Tensor, low: float, high: float) -> Tensor:
    """Angle limited smoothly: unchanged in the inner 80 % of its range, never beyond it."""
    middle, half = (low + high) / 2, (high - low) / 2
    scaled = (angle - middle) / half
    over = (scaled.abs() - 0.8).clamp_min(0)
    return middle + half * scaled.sign() * (scaled.abs() - over + 0.2 * torch.tanh(over / 0.2))


def _hinged(hinge: Tensor, bone: Tensor) -> Tensor:
    """Axes of a leg bone: X along the hinge, Y opposite to the bone."""
    return torch.stack([hinge, -bone, torch.linalg.cross(hinge, -bone)], -1)


def matrix_from_euler(angles: Float[Tensor, "*n 3"], order: str) -> Float[Tensor, "*n 3 3"]:
    """Intrinsic Euler angles, in the order of the letters: "zyx" gives Rz(a0) Ry(a1) Rx(a2)."""
    first, second, third = (about(axis, angles[..., i]) for i, axis in enumerate(order))
    return first @ second @ third


def about(axis: str, angle: Float[Tensor, "*n"]) -> Float[Tensor, "*n 3 3"]:
    """Rotation about one axis, "x", "y" or "z", by an angle in radians."""
    unit = {"x": _X, "y": _Y, "z": _Z}[axis]
    return matrix_from_axis_angle(angle[..., None] * unit.to(angle))


def for_side(rotation: Tensor, side: int) -> Tensor:
    """A rotation of the left side for the given side: mirrored in x for the right."""
    return rotation if side == 0 else rotation * _MIRROR


def offset_of(name: str) -> Float[Tensor, " 3"]:
    """Where a joint of our rig is in its parent, metres, in double precision."""
    return torch.from_numpy(HUMANOID.offsets[HUMANOID.index(name)]).double()


def _tensor(array: NDArray[np.float32]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).double()


_X, _Y, _Z = torch.eye(3, dtype=torch.float64)
_FLAT = torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64)
_MIRROR = torch.tensor([[1.0, -1, -1], [-1, 1, 1], [-1, 1, 1]], dtype=torch.float64)
THUMB = F.normalize(offset_of("leftThumbProximal"), dim=-1)
_FOLD = torch.tensor([0.30, -0.45, -0.80], dtype=torch.float64)
THUMB_HINGE = F.normalize(torch.linalg.cross(THUMB, _FOLD), dim=-1)
THUMB_AWAY = F.normalize(torch.linalg.cross(THUMB, -_Y), dim=-1)
