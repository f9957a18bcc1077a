"""Legs against the torch two-bone solution, and on rigs whose thighs do not hang from the root."""

import numpy as np
import pytest
import torch

from echoavatar.motion.ik.chains import Chains
from echoavatar.motion.ik.leg import bend, legs_of
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import (
    angle_between,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from echoavatar.motion.kinematics.two_bone import reach
from echoavatar.nn.kernels import kernel

LEGS = ("UpperLeg", "LowerLeg", "Foot")


def bent(frames: int = 20) -> torch.Tensor:
    """Root-relative poses with bent legs, (t, j, 3, 3)."""
    generator = torch.Generator().manual_seed(0)
    turns = torch.zeros(frames, HUMANOID.joints, 3)
    turns[:, HUMANOID.indices(["leftUpperLeg", "rightUpperLeg"])] = 0.3 * torch.randn(frames, 2, 3, generator=generator)
    turns[:, HUMANOID.indices(["leftLowerLeg", "rightLowerLeg"]), 0] = 0.4 + torch.rand(frames, 2, generator=generator)
    turns[:, HUMANOID.indices(["leftFoot", "rightFoot"])] = 0.2 * torch.randn(frames, 2, 3, generator=generator)
    return matrix_from_axis_angle(turns)


@kernel()
def _bend(legs, rotations, turned, places, aside):  # type: ignore[no-untyped-def]
    for frame in range(len(rotations)):
        for side in range(2):
            way = (aside[0, side, frame], aside[1, side, frame], aside[2, side, frame])
            bend(legs, side, rotations[frame], turned[frame], places[frame], way)


def moved(skeleton: Skeleton, rotations: torch.Tensor, aside: np.ndarray) -> torch.Tensor:
    """Local rotations after both ankles (left, right) were asked to go by `aside` (3, 2, t)."""
    chains = Chains(skeleton, list(skeleton.config.feet))
    legs = legs_of(skeleton, chains)
    assert legs is not None
    quaternions = quaternion_from_matrix(rotations)
    pose = chains.pose(quaternions[None].numpy())
    _bend(legs, quaternions.numpy(), pose.rotations[0], pose.places[0], aside)
    return matrix_from_quaternion(quaternions)


def world(skeleton: Skeleton, rotations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    pose = forward_kinematics(skeleton, rotations, torch.zeros(len(rotations), 3))
    return pose.rotations, pose.positions


def test_ankles_arrive_and_feet_keep_their_direction() -> None:
    poses = bent()
    aside = np.random.default_rng(0).uniform(-0.04, 0.04, (3, 2, len(poses))).astype(np.float32)
    aside[1] = np.abs(aside[1])
    out = moved(HUMANOID, poses, aside)
    ankles = HUMANOID.indices(["leftFoot", "rightFoot"])
    (before, start), (after, end) = world(HUMANOID, poses), world(HUMANOID, out)
    np.testing.assert_allclose((end - start)[:, ankles].numpy(), aside.transpose(2, 1, 0), atol=2e-5, rtol=0)
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
    torch.testing.assert_close(new[:, hip], upper @ turns[:, hip], atol=2e-4, rtol=0)
    torch.testing.assert_close(new[:, knee], lower @ turns[:, knee], atol=2e-4, rtol=0)


def test_out_of_reach_stretches_towards_it() -> None:
    poses = bent()
    aside = np.zeros((3, 2, 20), np.float32)
    aside[1] = -2.0
    _, places = world(HUMANOID, moved(HUMANOID, poses, aside))
    hip, knee, ankle = (places[:, HUMANOID.index(f"left{bone}")] for bone in LEGS)
    length = (knee - hip).norm(dim=-1) + (ankle - knee).norm(dim=-1)
    torch.testing.assert_close((ankle - hip).norm(dim=-1), 0.9995 * length, atol=1e-4, rtol=0)


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
    turns = torch.zeros(6, 10, 3)
    turns[:, 1] = torch.tensor([0.2, 0.5, -0.1])
    turns[:, [3, 7], 0] = 0.6
    poses = matrix_from_axis_angle(turns)
    aside = np.full((3, 2, 6), 0.04, np.float32)
    out = moved(rig, poses, aside)
    (_, start), (_, end) = world(rig, poses), world(rig, out)
    torch.testing.assert_close(end[:, [4, 8]] - start[:, [4, 8]], torch.full((6, 2, 3), 0.04), atol=2e-5, rtol=0)


@pytest.mark.parametrize("feet", [(), (0, 0, 0, 0)])
def test_rigs_without_legs_have_none(feet: tuple[int, ...]) -> None:
    assert legs_of(Skeleton(HUMANOID.config.model_copy(update={"feet": feet}))) is None
