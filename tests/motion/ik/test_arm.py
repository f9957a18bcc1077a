from typing import NamedTuple

import numpy as np
import pytest
import torch

from echoavatar.motion.ik.arm import reach as reach_kernel
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion

RNG = np.random.default_rng(0)


class Turns(NamedTuple):
    swing: np.ndarray  # (3, 3, 1, n)
    bend: np.ndarray


def reach(shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, target: np.ndarray) -> Turns:
    count = max(a.shape[-1] for a in (shoulder, elbow, wrist, target))
    arms = [np.broadcast_to(a[:, 0], (3, count)).T.tolist() for a in (shoulder, elbow, wrist, target)]
    found = [reach_kernel(*(tuple(point) for point in one)) for one in zip(*arms, strict=True)]
    matrices = matrix_from_quaternion(torch.tensor(found, dtype=torch.double))  # (n, 2, 3, 3)
    return Turns(*matrices.permute(1, 2, 3, 0)[:, :, :, None].numpy())


def arm(bend: float, n: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shoulders (3, 1, n), elbows and wrists of arms of 0.3 m and 0.25 m in random planes."""
    shoulder = RNG.normal(size=(3, 1, n)) * 0.1
    first, other = (RNG.normal(size=(3, 1, n)) for _ in range(2))
    first /= np.linalg.norm(first, axis=0)
    other -= (other * first).sum(0) * first
    other /= np.linalg.norm(other, axis=0)
    elbow = shoulder + 0.3 * first
    return shoulder, elbow, elbow + 0.25 * (np.cos(bend) * first + np.sin(bend) * other)


def moved(shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, target: np.ndarray) -> np.ndarray:
    turns = reach(shoulder, elbow, wrist, target)
    forearm = np.einsum("ij...,j...->i...", turns.bend, wrist - elbow)
    both: np.ndarray = np.einsum("ij...,j...->i...", turns.swing, elbow - shoulder + forearm)
    return shoulder + both


def test_a_bent_arm_meets_every_target_within_reach() -> None:
    shoulder, elbow, wrist = arm(1.2, 200)
    way = RNG.normal(size=wrist.shape)
    target = shoulder + way / np.linalg.norm(way, axis=0) * RNG.uniform(0.1, 0.53, size=(1, 200))
    np.testing.assert_allclose(moved(shoulder, elbow, wrist, target), target, atol=1e-6)


def test_turns_are_rotations_and_none_without_need() -> None:
    shoulder, elbow, wrist = arm(1.0, 20)
    turns = reach(shoulder, elbow, wrist, wrist + 0.05)
    for turn in turns:
        square = np.einsum("ji...,jk...->ik...", turn, turn)
        np.testing.assert_allclose(square, np.eye(3)[:, :, None, None] + 0 * square, atol=1e-6)
        assert np.abs(turn - np.eye(3)[:, :, None, None]).max() > 0.01
    for turn in reach(shoulder, elbow, wrist, wrist):
        np.testing.assert_allclose(turn, np.eye(3)[:, :, None, None] + 0 * turn, atol=5e-7)


def test_a_straight_arm_gets_the_direction() -> None:
    """It has no plane to bend in, so its length stays 0.55 m."""
    shoulder = np.zeros((3, 1, 1))
    elbow, wrist = shoulder.copy(), shoulder.copy()
    elbow[0], wrist[0] = 0.3, 0.55
    target = np.array([0.3, 0.1, 0.2]).reshape(3, 1, 1)
    got = moved(shoulder, elbow, wrist, target)[:, 0, 0]
    np.testing.assert_allclose(got / np.linalg.norm(got), target[:, 0, 0] / np.linalg.norm(target), atol=1e-6)
    assert np.linalg.norm(got) == pytest.approx(0.55)


def test_a_low_target_out_of_reach_is_raised_above_itself() -> None:
    shoulder = np.zeros((3, 1, 1))
    elbow, wrist = shoulder.copy(), shoulder.copy()
    elbow[1], wrist[:, 0, 0] = -0.3, (0.0, -0.5, 0.15)
    target = np.array([0.1, -0.9, 0.2]).reshape(3, 1, 1)
    got = moved(shoulder, elbow, wrist, target)[:, 0, 0]
    np.testing.assert_allclose(got[[0, 2]], [0.1, 0.2], atol=1e-5)
    assert -0.55 < got[1] < -0.4


@pytest.mark.parametrize("bend", [0.0, 0.02, 0.1, 0.3, 2.0])
def test_the_elbow_answers_small_moves_with_small_turns(bend: float) -> None:
    """Also where the plain law of cosines has no slope: at the straight arm."""
    shoulder, elbow, wrist = arm(bend)
    inwards = (shoulder - wrist) / np.linalg.norm(shoulder - wrist, axis=0)
    angles = []
    for step in np.arange(0, 0.05, 0.001):
        turn = reach(shoulder, elbow, wrist, wrist + step * inwards).bend[:, :, 0, 0]
        angles.append(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    assert np.abs(np.diff(angles)).max() < 0.04
