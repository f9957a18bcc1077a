"""Motion made by hand, whose contacts are known: a body that steps from side to side, claps, or touches itself."""

from typing import NamedTuple

import numpy as np
import torch
from tests.motion.ik.poses import kept_out
from torch import Tensor

from echoavatar.motion.ik import BodyProfile, HandCollisions, body_of_rig
from echoavatar.motion.ik.hand_contact import find_arm
from echoavatar.motion.kinematics import HUMANOID, Motion, forward_kinematics
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import (
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
    slerp,
)
from echoavatar.motion.kinematics.two_bone import reach

FPS = 30.0
CLAP_SECONDS, STEP_SECONDS = 0.8, 1.0


def clapping(seconds: float = 6.0) -> Motion:
    """Palms meet every 0.8 s at 2 cm; every second one foot steps 12 cm aside, lifted by 7 cm."""
    time, turns, root = _stepping(seconds)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns = _limb(turns, root, side, "Arm", "Hand", *_hand(time, sign, root))
    return _motion(turns, root)


class Touch(NamedTuple):
    """A palm that lies on a part of our character's body, from one second to another."""

    side: str
    bone: str
    towards: tuple[float, float, float]  # where on the part, in shares of its half axes
    fingers: tuple[float, float, float]  # where they point
    start: float
    stop: float


TOUCHES = (
    Touch("left", "head", (0.88, -0.2, 0.45), (-0.1, 0.9, 0.25), 0.8, 2.0),
    Touch("right", "hips", (-0.9, 0.45, 0.2), (0.25, -0.45, 0.85), 0.8, 2.0),
    Touch("left", "spine", (0.25, 0.0, 1.0), (-0.95, 0.1, 0.2), 3.2, 4.4),
    Touch("right", "upperChest", (0.2, 0.1, 1.0), (0.85, 0.4, 0.2), 3.2, 4.4),
)


def felt(motion: Motion, profile: BodyProfile, touch: Touch) -> tuple[np.ndarray, np.ndarray]:
    """Where on its part the palm is while it touches, in shares of the part's half axes; and these, with the palm."""
    frames = slice(round((touch.start + 0.1) * FPS), round((touch.stop - 0.1) * FPS))
    part = next(part for part in profile.parts if part.bone == touch.bone)
    pose, joint = motion.pose(), bone_map(motion.skeleton)[touch.bone]
    away = palms(motion)[frames, int(touch.side == "right")].numpy() - pose.positions[frames, joint].numpy()
    local = np.einsum("tij,ti->tj", pose.rotations[frames, joint].numpy(), away) - part.centre
    radii = np.array(part.radii) + profile.palm
    return local / radii, radii


def touching(seconds: float = 5.2) -> Motion:
    """A hand on the cheek and one on the hip; then one on the belly and one on the heart."""
    time, turns, root = _stepping(seconds)
    pose = forward_kinematics(HUMANOID, turns, root)
    body = body_of_rig(HUMANOID)
    parts = {part.bone: part for part in body.parts}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        ahead, inward = torch.tensor([0.0, 0.3, 0.95]).double(), torch.tensor([-sign, 0.0, 0.0]).double()
        palm = root + torch.tensor([sign * 0.26, 0.15, 0.34]).double()
        hand = quaternion_from_matrix(_facing(sign, ahead, inward)).expand(len(time), 4)
        for touch in (touch for touch in TOUCHES if touch.side == side):
            part, joint = parts[touch.bone], HUMANOID.index(touch.bone)
            towards = torch.tensor(touch.towards).double()
            on = torch.tensor(part.centre) + (torch.tensor(part.radii) + body.palm) * towards / towards.norm()
            place = pose.positions[:, joint] + pose.rotations[:, joint] @ on.double()
            normal = -towards / torch.tensor(part.radii).double()
            turn = pose.rotations[:, joint] @ _facing(sign, torch.tensor(touch.fingers).double(), normal)
            share = _eased((time - touch.start + 0.6) / 0.6) - _eased((time - touch.stop) / 0.6)
            palm = palm + share[:, None] * (place - palm)
            hand = slerp(hand, quaternion_from_matrix(turn), share)
        turns = _limb(turns, root, side, "Arm", "Hand", *_wrist(sign, palm, matrix_from_quaternion(hand)))
    free = kept_out(HandCollisions(HUMANOID, body), turns[None].float())[
        0
    ].double()  # fingers are straight: they may be inside
    return _motion(free, root)


def _facing(sign: float, fingers: Tensor, palm: Tensor) -> Tensor:
    """Rotation of a hand whose fingers point so and whose palm looks as nearly so as it can."""
    along = sign * fingers / fingers.norm()
    up = -(palm - (palm @ along) * along)
    up = up / up.norm()
    return torch.stack([along, up, torch.linalg.cross(along, up)], 1)


def _stepping(seconds: float) -> tuple[Tensor, Tensor, Tensor]:
    """Times, rotations and root of a body that sways and steps; its arms are at rest."""
    time = torch.arange(round(seconds * FPS), dtype=torch.double) / FPS
    turns = torch.eye(3).double().repeat(len(time), HUMANOID.joints, 1, 1)
    sway = torch.sin(2 * torch.pi * time / (2 * STEP_SECONDS))
    turns[:, 0] = about("y", 0.1 * sway)
    turns[:, HUMANOID.index("spine")] = about("x", 0.05 * torch.sin(torch.pi * time))
    root = torch.stack([0.05 * sway, 0.91 + 0 * time, 0 * time], 1)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns = _limb(turns, root, side, "Leg", "Foot", _foot(time, sign), torch.eye(3).double())
    return time, turns, root


def _motion(turns: Tensor, root: Tensor) -> Motion:
    rotations = quaternion_from_matrix(turns).numpy().astype(np.float32)
    return Motion(HUMANOID, rotations, root.numpy().astype(np.float32), FPS)


def claps(motion: Motion) -> np.ndarray:
    """Frames in the middle of each clap."""
    return np.arange(0, motion.seconds - 1 / FPS, CLAP_SECONDS) * FPS + 0.5


def about(axis: str, angle: Tensor) -> Tensor:
    vector = torch.zeros(len(angle), 3, dtype=torch.double)
    vector[:, "xyz".index(axis)] = angle
    return matrix_from_axis_angle(vector)


def _foot(time: Tensor, sign: float) -> Tensor:
    """Where the ankle is: it steps out in its own second and back in the one after next."""
    phase = torch.remainder(time / STEP_SECONDS - (0.0 if sign > 0 else 1.0), 4.0)
    out = _eased(phase / 0.4) - _eased((phase - 2.0) / 0.4)
    lift = torch.zeros_like(phase)
    for start in (0.0, 2.0):
        share = ((phase - start) / 0.4).clamp(0, 1)
        lift = lift + 0.07 * torch.sin(torch.pi * share) ** 2
    rest = HUMANOID.rest_positions[HUMANOID.index("leftFoot")]
    return torch.stack([sign * (float(rest[0]) + 0.12 * out), float(rest[1]) + lift, float(rest[2]) + 0 * lift], 1)


def _eased(share: Tensor) -> Tensor:
    share = share.clamp(0, 1)
    return share.pow(3) * (10 - 15 * share + 6 * share.square())


def _hand(time: Tensor, sign: float, root: Tensor) -> tuple[Tensor, Tensor]:
    """The wrist's place, so that the palm is where it claps; the hand's rotation."""
    ahead = torch.tensor([0.0, 0.5, 0.8660254]).double()
    inward = torch.tensor([-sign, 0.0, 0.0]).double()
    columns = [sign * ahead, -inward, torch.linalg.cross(sign * ahead, -inward)]
    hand = torch.stack(columns, 1).expand(len(time), 3, 3)
    open_ = 0.5 - 0.5 * torch.cos(2 * torch.pi * time / CLAP_SECONDS)
    palm = torch.stack([sign * (0.01 + 0.22 * open_), 1.2 + 0 * time, 0.32 + 0 * time], 1)
    palm[:, 0] += root[:, 0]
    return _wrist(sign, palm, hand)


def _wrist(sign: float, palm: Tensor, hand: Tensor) -> tuple[Tensor, Tensor]:
    """The place of the wrist whose palm is there."""
    offset = 0.8 * HUMANOID.offsets[HUMANOID.index("leftMiddleProximal")].double() * torch.tensor([sign, 1, 1])
    return palm - hand @ offset, hand


def _limb(turns: Tensor, root: Tensor, side: str, kind: str, end: str, target: Tensor, last: Tensor) -> Tensor:
    """Bring the end of a limb to a place, with its last bone turned so."""
    upper, lower, tip = (HUMANOID.index(side + name) for name in (f"Upper{kind}", f"Lower{kind}", end))
    pose = forward_kinematics(HUMANOID, turns, root)
    if kind == "Leg":
        hinge = torch.tensor([1.0, 0.0, 0.0]).double()
    else:
        hinge = torch.tensor([0.3, -1.0 if side == "left" else 1.0, 0.0]).double()
        hinge = hinge / hinge.norm()
    first, second = reach(
        hip=pose.positions[:, upper],
        knee=pose.positions[:, lower],
        ankle=pose.positions[:, tip],
        hinge=hinge.expand(len(root), 3),
        target=target,
    )
    above, below = first @ pose.rotations[:, upper], second @ pose.rotations[:, lower]
    turns = turns.clone()
    turns[:, upper] = pose.rotations[:, HUMANOID.parents[upper]].transpose(-1, -2) @ above
    turns[:, lower] = above.transpose(-1, -2) @ below
    turns[:, tip] = below.transpose(-1, -2) @ last
    return turns


def palms(motion: Motion) -> torch.Tensor:
    """World positions of the left and the right palm, (t, 2, 3)."""
    pose = forward_kinematics(motion.skeleton, motion.matrices().double(), torch.from_numpy(motion.root).double())
    arms = [find_arm(motion.skeleton, side) for side in ("left", "right")]
    return torch.stack(
        [pose.positions[:, arm.limb.joints[2]] + (pose.rotations[:, arm.limb.joints[2]] @ arm.palm) for arm in arms], 1
    )
