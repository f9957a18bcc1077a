"""Motion made by hand, whose contacts are known: a body that steps from side to side, claps, or touches itself."""

from typing import NamedTuple

import numpy as np
from tests.motion.ik.poses import kept_out

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
    away = palms(motion)[frames, int(touch.side == "right")] - pose.positions[frames, joint]
    local = np.einsum("tij,ti->tj", pose.rotations[frames, joint], away) - part.centre
    radii = np.array(part.radii) + profile.palm
    return local / radii, radii


def touching(seconds: float = 5.2) -> Motion:
    """A hand on the cheek and one on the hip; then one on the belly and one on the heart."""
    time, turns, root = _stepping(seconds)
    pose = forward_kinematics(HUMANOID, turns, root)
    body = body_of_rig(HUMANOID)
    parts = {part.bone: part for part in body.parts}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        ahead, inward = np.array([0.0, 0.3, 0.95]), np.array([-sign, 0.0, 0.0])
        palm = root + np.array([sign * 0.26, 0.15, 0.34])
        hand = np.broadcast_to(quaternion_from_matrix(_facing(sign, ahead, inward)), (len(time), 4))
        for touch in (touch for touch in TOUCHES if touch.side == side):
            part, joint = parts[touch.bone], HUMANOID.index(touch.bone)
            towards = np.array(touch.towards)
            on = np.array(part.centre) + (np.array(part.radii) + body.palm) * towards / np.linalg.norm(towards)
            place = pose.positions[:, joint] + pose.rotations[:, joint] @ on
            normal = -towards / np.array(part.radii)
            turn = pose.rotations[:, joint] @ _facing(sign, np.array(touch.fingers), normal)
            share = _eased((time - touch.start + 0.6) / 0.6) - _eased((time - touch.stop) / 0.6)
            palm = palm + share[:, None] * (place - palm)
            hand = slerp(hand, quaternion_from_matrix(turn), share)
        turns = _limb(turns, root, side, "Arm", "Hand", *_wrist(sign, palm, matrix_from_quaternion(hand)))
    free = kept_out(HandCollisions(HUMANOID, body), turns[None].astype(np.float32))[0].astype(
        np.float64
    )  # fingers are straight: they may be inside
    return _motion(free, root)


def _facing(sign: float, fingers: np.ndarray, palm: np.ndarray) -> np.ndarray:
    """Rotation of a hand whose fingers point so and whose palm looks as nearly so as it can."""
    along = sign * fingers / np.linalg.norm(fingers)
    up = -(palm - (palm @ along) * along)
    up = up / np.linalg.norm(up)
    return np.stack([along, up, np.cross(along, up)], 1)


def _stepping(seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, rotations and root of a body that sways and steps; its arms are at rest."""
    time = np.arange(round(seconds * FPS), dtype=np.float64) / FPS
    turns = np.tile(np.eye(3), (len(time), HUMANOID.joints, 1, 1))
    sway = np.sin(2 * np.pi * time / (2 * STEP_SECONDS))
    turns[:, 0] = about("y", 0.1 * sway)
    turns[:, HUMANOID.index("spine")] = about("x", 0.05 * np.sin(np.pi * time))
    root = np.stack([0.05 * sway, 0.91 + 0 * time, 0 * time], 1)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns = _limb(turns, root, side, "Leg", "Foot", _foot(time, sign), np.eye(3))
    return time, turns, root


def _motion(turns: np.ndarray, root: np.ndarray) -> Motion:
    rotations = quaternion_from_matrix(turns).astype(np.float32)
    return Motion(HUMANOID, rotations, root.astype(np.float32), FPS)


def claps(motion: Motion) -> np.ndarray:
    """Frames in the middle of each clap."""
    return np.arange(0, motion.seconds - 1 / FPS, CLAP_SECONDS) * FPS + 0.5


def about(axis: str, angle: np.ndarray) -> np.ndarray:
    vector = np.zeros((len(angle), 3), np.float64)
    vector[:, "xyz".index(axis)] = angle
    return matrix_from_axis_angle(vector)


def _foot(time: np.ndarray, sign: float) -> np.ndarray:
    """Where the ankle is: it steps out in its own second and back in the one after next."""
    phase = np.remainder(time / STEP_SECONDS - (0.0 if sign > 0 else 1.0), 4.0)
    out = _eased(phase / 0.4) - _eased((phase - 2.0) / 0.4)
    lift = np.zeros_like(phase)
    for start in (0.0, 2.0):
        share = np.clip((phase - start) / 0.4, 0, 1)
        lift = lift + 0.07 * np.sin(np.pi * share) ** 2
    rest = HUMANOID.rest_positions[HUMANOID.index("leftFoot")]
    return np.stack([sign * (float(rest[0]) + 0.12 * out), float(rest[1]) + lift, float(rest[2]) + 0 * lift], 1)


def _eased(share: np.ndarray) -> np.ndarray:
    share = np.clip(share, 0, 1)
    return share**3 * (10 - 15 * share + 6 * share**2)


def _hand(time: np.ndarray, sign: float, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The wrist's place, so that the palm is where it claps; the hand's rotation."""
    ahead = np.array([0.0, 0.5, 0.8660254])
    inward = np.array([-sign, 0.0, 0.0])
    columns = [sign * ahead, -inward, np.cross(sign * ahead, -inward)]
    hand = np.broadcast_to(np.stack(columns, 1), (len(time), 3, 3))
    open_ = 0.5 - 0.5 * np.cos(2 * np.pi * time / CLAP_SECONDS)
    palm = np.stack([sign * (0.01 + 0.22 * open_), 1.2 + 0 * time, 0.32 + 0 * time], 1)
    palm[:, 0] += root[:, 0]
    return _wrist(sign, palm, hand)


def _wrist(sign: float, palm: np.ndarray, hand: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The place of the wrist whose palm is there."""
    offset = 0.8 * HUMANOID.offsets[HUMANOID.index("leftMiddleProximal")].astype(np.float64) * np.array([sign, 1, 1])
    return palm - hand @ offset, hand


def _limb(
    turns: np.ndarray, root: np.ndarray, side: str, kind: str, end: str, target: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Bring the end of a limb to a place, with its last bone turned so."""
    upper, lower, tip = (HUMANOID.index(side + name) for name in (f"Upper{kind}", f"Lower{kind}", end))
    pose = forward_kinematics(HUMANOID, turns, root)
    if kind == "Leg":
        hinge = np.array([1.0, 0.0, 0.0])
    else:
        hinge = np.array([0.3, -1.0 if side == "left" else 1.0, 0.0])
        hinge = hinge / np.linalg.norm(hinge)
    first, second = reach(
        hip=pose.positions[:, upper],
        knee=pose.positions[:, lower],
        ankle=pose.positions[:, tip],
        hinge=np.broadcast_to(hinge, (len(root), 3)),
        target=target,
    )
    above, below = first @ pose.rotations[:, upper], second @ pose.rotations[:, lower]
    turns = turns.copy()
    turns[:, upper] = pose.rotations[:, HUMANOID.parents[upper]].mT @ above
    turns[:, lower] = above.mT @ below
    turns[:, tip] = below.mT @ last
    return turns


def palms(motion: Motion) -> np.ndarray:
    """World positions of the left and the right palm, (t, 2, 3)."""
    pose = forward_kinematics(motion.skeleton, motion.matrices().astype(np.float64), motion.root.astype(np.float64))
    arms = [find_arm(motion.skeleton, side) for side in ("left", "right")]
    return np.stack(
        [pose.positions[:, arm.limb.joints[2]] + (pose.rotations[:, arm.limb.joints[2]] @ arm.palm) for arm in arms], 1
    )
