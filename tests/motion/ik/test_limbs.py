"""The compiled loops against those of whole clips, and on rigs whose thighs do not hang from the root."""

from typing import NamedTuple

import numpy as np
import pytest

from echoavatar.motion.ik.limbs import Chains, bend, legs_of
from echoavatar.motion.ik.limbs import reach as reach_kernel
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    angle_between,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from echoavatar.motion.kinematics.two_bone import reach
from echoavatar.nn.kernels import kernel


def test_frames_are_those_of_forward_kinematics() -> None:
    turns = np.random.default_rng(0).standard_normal((11, HUMANOID.joints, 3))
    turns[:, 0] = 0
    rotations = matrix_from_axis_angle(turns)
    wanted = HUMANOID.indices(["head", "leftIndexDistal", "leftThumbDistal", "rightHand"])
    chains = Chains(HUMANOID, wanted)
    quaternions = quaternion_from_matrix(rotations)[None]
    ours = chains.pose(quaternions)
    pose = forward_kinematics(HUMANOID, rotations, np.zeros((11, 3), np.float32))
    turned = matrix_from_quaternion(ours.rotations[0])
    np.testing.assert_allclose(turned, pose.rotations[:, chains.joints], atol=1e-5, rtol=0)
    places = ours.places[0]
    np.testing.assert_allclose(places, pose.positions[:, chains.joints], atol=1e-5, rtol=0)


def test_the_root_stands_at_the_origin_and_only_what_is_needed_is_worked_out() -> None:
    chains = Chains(HUMANOID, [HUMANOID.index("head")])
    assert chains.joints[0] == 0
    assert HUMANOID.index("leftFoot") not in chains.joints
    turned = np.zeros((1, HUMANOID.joints, 3), np.float32)
    turned[0, 0, 1] = 1.0
    pose = chains.pose(quaternion_from_matrix(matrix_from_axis_angle(turned))[None])
    assert pose.rotations[0, 0, 0].tolist() == [1, 0, 0, 0]
    assert pose.places[0, 0, 0].tolist() == [0, 0, 0]


RNG = np.random.default_rng(0)


class Turns(NamedTuple):
    swing: np.ndarray  # (3, 3, 1, n)
    bend: np.ndarray


def turns_of(shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, target: np.ndarray) -> Turns:
    count = max(a.shape[-1] for a in (shoulder, elbow, wrist, target))
    arms = [np.broadcast_to(a[:, 0], (3, count)).T.tolist() for a in (shoulder, elbow, wrist, target)]
    found = [reach_kernel(*(tuple(point) for point in one)) for one in zip(*arms, strict=True)]
    matrices = matrix_from_quaternion(np.array(found, np.float64))  # (n, 2, 3, 3)
    return Turns(*np.moveaxis(matrices, 0, -1)[:, :, :, None])


def arm(bend: float, n: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shoulders (3, 1, n), elbows and wrists of arms of 0.3 m and 0.25 m in random planes."""
    shoulder = RNG.normal(size=(3, 1, n)) * 0.1
    first, other = (RNG.normal(size=(3, 1, n)) for _ in range(2))
    first /= np.linalg.norm(first, axis=0)
    other -= (other * first).sum(0) * first
    other /= np.linalg.norm(other, axis=0)
    elbow = shoulder + 0.3 * first
    return shoulder, elbow, elbow + 0.25 * (np.cos(bend) * first + np.sin(bend) * other)


def hand_of(shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, target: np.ndarray) -> np.ndarray:
    turns = turns_of(shoulder, elbow, wrist, target)
    forearm = np.einsum("ij...,j...->i...", turns.bend, wrist - elbow)
    both: np.ndarray = np.einsum("ij...,j...->i...", turns.swing, elbow - shoulder + forearm)
    return shoulder + both


def test_a_bent_arm_meets_every_target_within_reach() -> None:
    shoulder, elbow, wrist = arm(1.2, 200)
    way = RNG.normal(size=wrist.shape)
    target = shoulder + way / np.linalg.norm(way, axis=0) * RNG.uniform(0.1, 0.53, size=(1, 200))
    np.testing.assert_allclose(hand_of(shoulder, elbow, wrist, target), target, atol=1e-6)


def test_turns_are_rotations_and_none_without_need() -> None:
    shoulder, elbow, wrist = arm(1.0, 20)
    turns = turns_of(shoulder, elbow, wrist, wrist + 0.05)
    for turn in turns:
        square = np.einsum("ji...,jk...->ik...", turn, turn)
        np.testing.assert_allclose(square, np.eye(3)[:, :, None, None] + 0 * square, atol=1e-6)
        assert np.abs(turn - np.eye(3)[:, :, None, None]).max() > 0.01
    for turn in turns_of(shoulder, elbow, wrist, wrist):
        np.testing.assert_allclose(turn, np.eye(3)[:, :, None, None] + 0 * turn, atol=5e-7)


def test_a_straight_arm_gets_the_direction() -> None:
    """It has no plane to bend in, so its length stays 0.55 m."""
    shoulder = np.zeros((3, 1, 1))
    elbow, wrist = shoulder.copy(), shoulder.copy()
    elbow[0], wrist[0] = 0.3, 0.55
    target = np.array([0.3, 0.1, 0.2]).reshape(3, 1, 1)
    got = hand_of(shoulder, elbow, wrist, target)[:, 0, 0]
    np.testing.assert_allclose(got / np.linalg.norm(got), target[:, 0, 0] / np.linalg.norm(target), atol=1e-6)
    assert np.linalg.norm(got) == pytest.approx(0.55)


def test_a_low_target_out_of_reach_is_raised_above_itself() -> None:
    shoulder = np.zeros((3, 1, 1))
    elbow, wrist = shoulder.copy(), shoulder.copy()
    elbow[1], wrist[:, 0, 0] = -0.3, (0.0, -0.5, 0.15)
    target = np.array([0.1, -0.9, 0.2]).reshape(3, 1, 1)
    got = hand_of(shoulder, elbow, wrist, target)[:, 0, 0]
    np.testing.assert_allclose(got[[0, 2]], [0.1, 0.2], atol=1e-5)
    assert -0.55 < got[1] < -0.4


@pytest.mark.parametrize("bend", [0.0, 0.02, 0.1, 0.3, 2.0])
def test_the_elbow_answers_small_moves_with_small_turns(bend: float) -> None:
    """Also where the plain law of cosines has no slope: at the straight arm."""
    shoulder, elbow, wrist = arm(bend)
    inwards = (shoulder - wrist) / np.linalg.norm(shoulder - wrist, axis=0)
    angles = []
    for step in np.arange(0, 0.05, 0.001):
        turn = turns_of(shoulder, elbow, wrist, wrist + step * inwards).bend[:, :, 0, 0]
        angles.append(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    assert np.abs(np.diff(angles)).max() < 0.04


LEGS = ("UpperLeg", "LowerLeg", "Foot")


def bent(frames: int = 20) -> np.ndarray:
    """Root-relative poses with bent legs, (t, j, 3, 3)."""
    generator = np.random.default_rng(0)
    turns = np.zeros((frames, HUMANOID.joints, 3), np.float32)
    turns[:, HUMANOID.indices(["leftUpperLeg", "rightUpperLeg"])] = 0.3 * generator.standard_normal((frames, 2, 3))
    turns[:, HUMANOID.indices(["leftLowerLeg", "rightLowerLeg"]), 0] = 0.4 + generator.random((frames, 2))
    turns[:, HUMANOID.indices(["leftFoot", "rightFoot"])] = 0.2 * generator.standard_normal((frames, 2, 3))
    return matrix_from_axis_angle(turns)


@kernel()
def _bend(legs, rotations, turned, places, aside):  # type: ignore[no-untyped-def]
    for frame in range(len(rotations)):
        for side in range(2):
            way = (aside[0, side, frame], aside[1, side, frame], aside[2, side, frame])
            bend(legs, side, rotations[frame], turned[frame], places[frame], way)


def moved(skeleton: Skeleton, rotations: np.ndarray, aside: np.ndarray) -> np.ndarray:
    """Local rotations after both ankles (left, right) were asked to go by `aside` (3, 2, t)."""
    chains = Chains(skeleton, list(skeleton.config.feet))
    legs = legs_of(skeleton, chains)
    assert legs is not None
    quaternions = quaternion_from_matrix(rotations)
    pose = chains.pose(quaternions[None])
    _bend(legs, quaternions, pose.rotations[0], pose.places[0], aside)
    return matrix_from_quaternion(quaternions)


def world(skeleton: Skeleton, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pose = forward_kinematics(skeleton, rotations, np.zeros((len(rotations), 3), np.float32))
    return pose.rotations, pose.positions


def test_ankles_arrive_and_feet_keep_their_direction() -> None:
    poses = bent()
    aside = np.random.default_rng(0).uniform(-0.04, 0.04, (3, 2, len(poses))).astype(np.float32)
    aside[1] = np.abs(aside[1])
    out = moved(HUMANOID, poses, aside)
    ankles = HUMANOID.indices(["leftFoot", "rightFoot"])
    (before, start), (after, end) = world(HUMANOID, poses), world(HUMANOID, out)
    np.testing.assert_allclose((end - start)[:, ankles], aside.transpose(2, 1, 0), atol=2e-5, rtol=0)
    assert angle_between(before[:, ankles], after[:, ankles]).max() < 1e-3


def test_it_is_the_two_bone_solution() -> None:
    poses, aside = bent(), np.full((3, 2, 20), 0.03, np.float32)
    out = moved(HUMANOID, poses, aside)
    turns, places = world(HUMANOID, poses)
    hip, knee, ankle = (HUMANOID.index(f"left{bone}") for bone in LEGS)
    upper, lower = reach(
        hip=places[:, hip],
        knee=places[:, knee],
        ankle=places[:, ankle],
        hinge=turns[:, knee, :, 0],
        target=places[:, ankle] + 0.03,
    )
    new, _ = world(HUMANOID, out)
    np.testing.assert_allclose(new[:, hip], upper @ turns[:, hip], atol=2e-4, rtol=0)
    np.testing.assert_allclose(new[:, knee], lower @ turns[:, knee], atol=2e-4, rtol=0)


def test_out_of_reach_stretches_towards_it() -> None:
    poses = bent()
    aside = np.zeros((3, 2, 20), np.float32)
    aside[1] = -2.0
    _, places = world(HUMANOID, moved(HUMANOID, poses, aside))
    hip, knee, ankle = (places[:, HUMANOID.index(f"left{bone}")] for bone in LEGS)
    length = np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(ankle - hip, axis=-1), 0.9995 * length, atol=1e-4, rtol=0)


def test_thighs_may_hang_from_a_bone_under_the_root() -> None:
    """A turned pelvis bone between root and thighs: the ankles arrive all the same."""
    joints = [
        ("root", -1, (0.0, 0.9, 0.0)),
        ("pelvis", 0, (0.0, 0.05, 0.0)),
        *[
            (f"{side}{bone}", parent, offset)
            for k, (side, x) in enumerate((("left", 0.1), ("right", -0.1)))
            for bone, parent, offset in (
                ("UpperLeg", 1, (x, 0.0, 0.0)),
                ("LowerLeg", 2 + 4 * k, (0.0, -0.4, 0.0)),
                ("Foot", 3 + 4 * k, (0.0, -0.4, 0.0)),
                ("Toes", 4 + 4 * k, (0.0, -0.08, 0.12)),
            )
        ],
    ]
    config = HUMANOID.config.model_copy(
        update={
            "names": tuple(j[0] for j in joints),
            "parents": tuple(j[1] for j in joints),
            "offsets": tuple(j[2] for j in joints),
            "feet": (4, 5, 8, 9),
            "parts": {},
            "mirror": (),
            "tips": {},
            "vrm": {},
        }
    )
    rig = Skeleton(config)
    turns = np.zeros((6, 10, 3), np.float32)
    turns[:, 1] = np.array([0.2, 0.5, -0.1])
    turns[:, [3, 7], 0] = 0.6
    poses = matrix_from_axis_angle(turns)
    aside = np.full((3, 2, 6), 0.04, np.float32)
    out = moved(rig, poses, aside)
    (_, start), (_, end) = world(rig, poses), world(rig, out)
    np.testing.assert_allclose(
        end[:, [4, 8]] - start[:, [4, 8]], np.full((6, 2, 3), 0.04, dtype=np.float32), atol=2e-5, rtol=0
    )


@pytest.mark.parametrize("feet", [(), (0, 0, 0, 0)])
def test_rigs_without_legs_have_none(feet: tuple[int, ...]) -> None:
    assert legs_of(Skeleton(HUMANOID.config.model_copy(update={"feet": feet}))) is None
