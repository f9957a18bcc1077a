"""Captured motion as choreography controls: the inverse of `solver.solve`. Not in the paper.

Controls have fewer degrees of freedom than a body: the twist of the collarbone and the bend of the toes are lost, and
the trunk's bend is shared out over its joints in fixed parts.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion, euler_from_matrix, quaternion_from_matrix
from echoavatar_lab.corpora import solver
from echoavatar_lab.corpora.controls import RELAXED_FINGERS, Array, Controls
from echoavatar_lab.corpora.solver import matrix_from_euler

ROUNDS = 4
CERTAIN_BEND = 0.012  # metres: with less bend the elbow's direction is read from the twist of the upper arm
CERTAIN_KNEE = 0.03  # metres: with less bend the knee points where it does by default
FARTHEST = 3.0  # of the width over which the solver stretches a limb softly
Rotations = Float[Tensor, "t 3 3"]


def controls_from_motion(motion: Motion) -> Controls:
    """Controls whose solution is near `motion`, which is on our rig, in metres, with the floor at y = 0.

    Angles are continuous over time. Fingers that do not move at all are given as relaxed.
    """
    matrices, world, places = (torch.from_numpy(part).double() for part in (motion.matrices(), *motion.pose()))
    chest = world[:, HUMANOID.index("upperChest")]
    sides = [
        _arm(world, places, chest, side) | _leg(world, places, side) | {"fingers": _fingers(matrices, side)}
        for side in range(2)
    ]
    pelvis = world[:, 0]
    head = chest.mT @ world[:, HUMANOID.index("head")]
    return Controls(
        pelvis_position=_array(places[:, 0]),
        pelvis_rotation=_continuous(_array(_upright(pelvis))),
        spine=_continuous(_array(_shared(pelvis.mT @ chest, solver.SPINE_SHARE))),
        head=_continuous(_array(_shared(head, (solver.NECK_SHARE, 1 - solver.NECK_SHARE)))),
        **{name: np.stack([side[name] for side in sides], 1) for name in sides[0]},
    )


def _shared(goal: Rotations, shares: tuple[float, ...]) -> Float[Tensor, "t 3"]:
    """Yaw, pitch and roll whose shares, turned one after another, give the goal."""
    angles = _euler(goal, "yxz")
    for _ in range(ROUNDS):
        made = torch.eye(3, dtype=goal.dtype)
        for share in shares:
            made = made @ matrix_from_euler(angles * share, "yxz")
        angles = angles + _euler(made.mT @ goal, "yxz")
    return angles


def _arm(world: Tensor, places: Tensor, chest: Rotations, side: int) -> dict[str, Array]:
    """The curves of one arm, in mirrored chest axes."""
    name = solver.SIDES[side]
    across = torch.tensor([1.0 if side == 0 else -1.0, 1.0, 1.0], dtype=world.dtype)
    shoulder, upper, elbow, hand = (
        HUMANOID.index(name + bone) for bone in ("Shoulder", "UpperArm", "LowerArm", "Hand")
    )

    def seen(vector: Tensor) -> Tensor:
        return (chest.mT @ vector[..., None]).squeeze(-1) * across

    collar = F.normalize(seen(places[:, upper] - places[:, shoulder]), dim=-1)
    rest = F.normalize(solver.offset_of("leftUpperArm"), dim=-1)
    lift = torch.atan2(collar[:, 1], collar[:, 0]) - torch.atan2(rest[1], rest[0])
    forward = collar[:, 2].asin() - rest[2].asin()
    reach, bend = seen(places[:, hand] - places[:, upper]), seen(places[:, elbow] - places[:, upper])
    distance = reach.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    line = reach / distance
    aside = solver.off_line(bend, line)
    hinge = solver.for_side(chest.mT @ world[:, upper], side)[..., 1]
    twisted = torch.linalg.cross(hinge, line)
    swing = _swing(line, aside + CERTAIN_BEND * twisted)
    lengths = [float(solver.offset_of(f"left{bone}").norm()) for bone in ("LowerArm", "Hand")]
    wrist = line * _before_soft_reach(distance, sum(lengths))
    return {
        "shoulder": np.stack([_array(lift), _array(forward)], -1),
        "wrist": _array(wrist),
        "elbow_swing": swing,
        "palm": _palm(line, swing, distance, lengths, solver.for_side(chest.mT @ world[:, hand], side)),
    }


def _swing(line: Tensor, elbow: Tensor) -> Array:
    """The angle by which the elbow is lifted about the line from shoulder to wrist."""
    easy = solver.elbow_direction(line, torch.zeros(len(line), dtype=line.dtype))
    lifted = torch.linalg.cross(line, easy)
    return _continuous(_array(torch.atan2((elbow * lifted).sum(-1), (elbow * easy).sum(-1))))


def _palm(line: Tensor, swing: Array, distance: Tensor, lengths: list[float], hand: Rotations) -> Array:
    """Flex, deviation and pronation of the hand against the forearm as the solver places it."""
    bend = solver.elbow_direction(line, torch.from_numpy(swing).double())
    distance = distance.clamp_max(solver.REACH * sum(lengths))
    _, lower = solver.two_bones(line, bend, distance, *lengths)
    hinge = torch.linalg.cross(line, bend)
    forearm = torch.stack([lower, hinge, torch.linalg.cross(lower, hinge)], -1)
    angles = _continuous(_array(_euler(forearm.mT @ hand, "xyz")))
    limits = zip(solver.PALM_LIMITS, (-angles[:, 2], -angles[:, 1], angles[:, 0]), strict=True)
    return np.stack([_before_soft_clamp(angle, *ends) for ends, angle in limits], -1)


def _leg(world: Tensor, places: Tensor, side: int) -> dict[str, Array]:
    """The curves of one leg: place of the flat foot's ankle, the foot's three angles, and the knee's swing."""
    hip, knee, ankle = (HUMANOID.index(solver.SIDES[side] + bone) for bone in ("UpperLeg", "LowerLeg", "Foot"))
    outwards = 1 if side == 0 else -1
    angles = _continuous(_array(_upright(world[:, ankle])))
    yaw, pitch, _ = torch.from_numpy(angles).double().unbind(-1)
    place = places[:, ankle] - solver.raised_ankle(solver.about("y", yaw), world[:, ankle], pitch)
    line = F.normalize(places[:, ankle] - places[:, hip], dim=-1)
    easy = solver.knee_direction(line, yaw, world[:, 0], torch.zeros_like(yaw))
    aside = solver.off_line(places[:, knee] - places[:, hip], line) + CERTAIN_KNEE * easy
    swing = torch.atan2((aside * torch.linalg.cross(easy, line)).sum(-1), (aside * easy).sum(-1))
    return {
        "foot_position": _array(place),
        "foot_yaw": angles[:, 0],
        "foot_pitch": angles[:, 1],
        "foot_roll": angles[:, 2] * outwards,
        "knee_swing": _continuous(_array(swing)) * outwards,
    }


def _upright(rotations: Rotations) -> Float[Tensor, "t 3"]:
    """Yaw, pitch and roll with the roll within a quarter turn, so that a pitch may pass the vertical."""
    angles = _euler(rotations, "yxz")
    other = torch.stack([angles[:, 0] + torch.pi, torch.pi - angles[:, 1], angles[:, 2] + torch.pi], -1)
    return torch.where(angles[:, 2:].abs() > torch.pi / 2, other, angles)


def _fingers(local: Tensor, side: int) -> Array:
    """Curls, spread and opposition of one hand, by least squares over the joints of each digit."""
    name, out = solver.SIDES[side], np.zeros((len(local), 7), np.float32)
    joints = [j for j, joint in enumerate(HUMANOID.names) if joint.startswith(name) and joint.endswith(_DIGIT_ENDS)]
    if float((local[:, joints] - local[:1, joints]).abs().max()) < 1e-4:
        return np.broadcast_to(np.array(RELAXED_FINGERS, np.float32), out.shape).copy()

    def turn(bone: str) -> Array:
        matrix = solver.for_side(local[:, HUMANOID.index(name + bone)], side)
        return axis_angle_from_quaternion(quaternion_from_matrix(matrix.numpy()))

    most, spreads = np.array(solver.CURL_RANGE), []
    for i, finger in enumerate(solver.FINGERS):
        bones = [turn(finger + bone) for bone in ("Proximal", "Intermediate", "Distal")]
        out[:, i + 1] = np.clip(sum(-b[:, 2] * m for b, m in zip(bones, most, strict=True)) / (most**2).sum(), -0.12, 1)
        spreads.append(-bones[0][:, 1] / (1 - 0.8 * np.clip(out[:, i + 1], 0, 1)))
    wide = np.array(solver.SPREAD_RANGE)
    out[:, 5] = np.clip(np.stack(spreads, 1) @ wide / (wide**2).sum(), -1, 1)
    hinge, away = solver.THUMB_HINGE.numpy(), 0.75 * solver.THUMB_AWAY.numpy() + 0.55 * solver.THUMB.numpy()
    base, *rest = (turn("Thumb" + bone) for bone in ("Metacarpal", "Proximal", "Distal"))
    most = np.array(solver.THUMB_CURL[1:])
    out[:, 0] = np.clip(sum(b @ hinge * m for b, m in zip(rest, most, strict=True)) / (most**2).sum(), -0.12, 1)
    out[:, 6] = np.clip((base - out[:, :1] * solver.THUMB_CURL[0] * hinge) @ away / (away @ away), 0, 1)
    return out


def _before_soft_reach(distance: Tensor, length: float) -> Tensor:
    """Inverse of the solver's soft limit of a limb's reach."""
    easy, most, least, width = 0.94 * length, solver.REACH * length, 0.30 * length, 0.03 * length
    left = ((most - distance) / (most - easy)).clamp(float(np.exp(-FARTHEST)), 1.0)
    distance = torch.where(distance > easy, easy - (most - easy) * left.log(), distance)
    over = ((distance - least) / width).clamp_min(0.05)
    return torch.where(over < 20, least + width * torch.expm1(over).log(), distance)


def _before_soft_clamp(angle: Array, low: float, high: float) -> Array:
    """Inverse of the solver's soft limit of a wrist's angle; what lies beyond the limit comes near it."""
    middle, half = (low + high) / 2, (high - low) / 2
    scaled = (angle - middle) / half
    over = np.clip((np.abs(scaled) - 0.8) / 0.2, 0, 0.95)
    return np.asarray(middle + half * np.sign(scaled) * (np.minimum(np.abs(scaled), 0.8) + 0.2 * np.arctanh(over)))


def _continuous(angles: Array) -> Array:
    """Angles without jumps of full turns, whose median lies within half a turn of 0."""
    whole = np.unwrap(angles.astype(np.float64), axis=0)
    return np.asarray(whole - 2 * np.pi * np.round(np.median(whole, axis=0) / (2 * np.pi)), np.float32)


def _euler(rotations: Rotations, order: str) -> Float[Tensor, "t 3"]:
    return torch.from_numpy(euler_from_matrix(rotations.numpy(), order))


def _array(tensor: Tensor) -> Array:
    return np.asarray(tensor.numpy(), np.float32)


_DIGIT_ENDS = ("Proximal", "Intermediate", "Distal", "Metacarpal")
