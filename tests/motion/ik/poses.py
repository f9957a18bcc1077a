"""Poses for the tests of this room: arms bent to given wrist places, and a clip whose arms are pushed inwards."""

from pathlib import Path

import numpy as np

from echoavatar.motion.ik import HandCollisions
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from echoavatar.motion.kinematics.two_bone import reach
from echoavatar_lab.corpora.rehearsal.corpus import Plan, make_clip

ARM = [HUMANOID.index(name) for name in ("leftShoulder", "leftUpperArm", "leftLowerArm", "leftHand")]


def left_wrist_at(places: np.ndarray) -> np.ndarray:
    """Rotations (t, j, 3, 3) of an upright body whose left wrist is at `places` (t, 3) in the root's frame."""
    t = len(places)
    turns = np.zeros((t, HUMANOID.joints, 3), np.float32)
    turns[:, ARM[1], 2], turns[:, ARM[2], 1] = -0.9, -1.2
    turns[:, HUMANOID.index("rightUpperArm"), 2] = 1.2
    rotations = matrix_from_axis_angle(turns)
    pose = forward_kinematics(HUMANOID, rotations, np.zeros((t, 3), np.float32))
    hip, knee, ankle = (pose.positions[:, joint] for joint in ARM[1:])
    hinge = -pose.rotations[:, ARM[1], :, 1]
    upper, lower = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=places)
    world = pose.rotations
    raised, bent = upper @ world[:, ARM[1]], lower @ world[:, ARM[2]]
    rotations[:, ARM[1]] = world[:, ARM[0]].mT @ raised
    rotations[:, ARM[2]] = raised.mT @ bent
    return rotations


def wrists(rotations: np.ndarray) -> np.ndarray:
    """Places of the left and the right wrist in the root's frame, (t, 2, 3)."""
    upright = rotations.copy()
    upright[:, 0] = np.eye(3, dtype=np.float32)
    hands = HUMANOID.indices(["leftHand", "rightHand"])
    return forward_kinematics(HUMANOID, upright, np.zeros((len(rotations), 3), np.float32)).positions[:, hands]


def pushed_inwards(seconds: float = 12.0) -> np.ndarray:
    """Gestures of the rehearsal choreographer with both upper arms turned towards the body."""
    clip = make_clip(Plan(hours=seconds / 3600, seed=3, folder=Path(), clip_seconds=seconds), 0)
    turns = np.zeros((HUMANOID.joints, 3), np.float32)
    turns[HUMANOID.index("leftUpperArm")] = np.array([0.0, -0.6, -0.1])
    turns[HUMANOID.index("rightUpperArm")] = np.array([0.0, 0.6, 0.1])
    return matrix_from_axis_angle(turns) @ matrix_from_quaternion(np.array(clip.rotations))


def kept_out(collisions: HandCollisions, rotations: np.ndarray) -> np.ndarray:
    """`HandCollisions.resolve` for matrices (b, t, j, 3, 3); those of joints that it leaves alone keep every bit."""
    before = quaternion_from_matrix(rotations)
    after = before.copy()
    collisions.resolve(after)
    is_moved = (after != before).any(-1)
    out = rotations.copy()
    out[is_moved] = matrix_from_quaternion(after[is_moved])
    return out
