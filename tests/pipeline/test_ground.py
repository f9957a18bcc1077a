import math

import numpy as np
import pytest
import torch
from tests.pipeline.poses import legs_of, root_of, to_lanes

from echoavatar.ik.chains import Chains
from echoavatar.kinematics import HUMANOID, forward_kinematics
from echoavatar.kinematics.rotations import matrix_from_axis_angle
from echoavatar.pipeline.ground import Ground, GroundState

CHAINS = Chains(HUMANOID, list(HUMANOID.config.feet))


def walk(frames: int = 48) -> tuple[torch.Tensor, torch.Tensor]:
    """A pendulum of stiff legs: the pelvis rocks over planted feet, with wrong root velocities on top."""
    angle = 0.12 * torch.sin(torch.arange(frames) * 2 * math.pi / 24)
    turns = torch.zeros(1, frames, HUMANOID.joints, 3)
    for side in ("left", "right"):
        turns[:, :, HUMANOID.index(f"{side}UpperLeg"), 0] = angle
        turns[:, :, HUMANOID.index(f"{side}Foot"), 0] = -angle
    travel = torch.zeros(1, frames, 3)
    travel[..., 0] = 0.004  # the decoded velocity says: drift 4 mm a frame
    travel[..., 2] = 0.95 - 0.83 * (1 - angle.cos())
    return matrix_from_axis_angle(turns), travel


def step(
    ground: Ground,
    rotations: torch.Tensor,
    travel: torch.Tensor,
    state: GroundState,
    active: np.ndarray | None = None,
) -> torch.Tensor:
    """World positions of the root; `travel` is [vx, vz, height]."""
    pose = to_lanes(rotations, travel[..., [0, 2, 1]])
    ground.step(pose, legs_of(pose, CHAINS).points, state, active)
    return root_of(pose)


def foot_path(rotations: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    return forward_kinematics(HUMANOID, rotations, root).positions[:, :, list(HUMANOID.config.feet)]


def test_planted_feet_stay_where_they_are() -> None:
    rotations, travel = walk()
    ground = Ground(HUMANOID)
    root = step(ground, rotations, travel, ground.init_state(1))
    feet = foot_path(rotations, root)
    assert (feet[:, 1:, :, [0, 2]] - feet[:, :-1, :, [0, 2]]).norm(dim=-1).max() < 1e-4
    assert (
        feet[..., 1] - torch.from_numpy(ground.rest[:, 0, 0])
    ).abs().max() < 0.002  # and neither float nor sink


def test_in_the_air_the_decoded_velocity_counts() -> None:
    rotations, travel = walk()
    travel[..., 2] += 0.3
    ground = Ground(HUMANOID)
    root = step(ground, rotations, travel, ground.init_state(1))
    torch.testing.assert_close(root[:, 1:, 0] - root[:, :-1, 0], travel[:, 1:, 0])
    torch.testing.assert_close(root[..., 1], travel[..., 2])


@pytest.mark.parametrize("cuts", [[8] * 6, [16, 8, 24], [48]])
def test_any_chunking_gives_the_whole(cuts: list[int]) -> None:
    rotations, travel = walk()
    ground = Ground(HUMANOID)
    state, parts = ground.init_state(1), []
    for piece in zip(rotations.split(cuts, 1), travel.split(cuts, 1), strict=True):
        parts.append(step(ground, *piece, state))
    torch.testing.assert_close(torch.cat(parts, 1), step(ground, rotations, travel, ground.init_state(1)))


def test_idle_rows_do_not_move_and_neighbours_do_not_matter() -> None:
    rotations, travel = walk()
    ground = Ground(HUMANOID)
    state = ground.init_state(2)
    both = (rotations.expand(2, -1, -1, -1, -1), travel.expand(2, -1, -1))
    first = step(ground, *both, state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.tensors())
    alone = step(ground, rotations, travel, ground.init_state(1))
    assert torch.equal(first[:1], alone)
