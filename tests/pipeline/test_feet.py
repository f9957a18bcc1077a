import math

import numpy as np
import pytest
import torch
from tests.pipeline.poses import legs_of, matrices_of, to_lanes

from echoavatar.ik.chains import Chains
from echoavatar.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.kinematics.rotations import angle_between, matrix_from_axis_angle
from echoavatar.pipeline.feet import Feet, FeetState

BALLS = list(HUMANOID.config.feet)[1::2]
CHAINS = Chains(HUMANOID, list(HUMANOID.config.feet))


def step(
    feet: Feet,
    rotations: torch.Tensor,
    root: torch.Tensor,
    state: FeetState,
    active: np.ndarray | None = None,
) -> torch.Tensor:
    pose = to_lanes(rotations, root)
    feet.step(pose, legs_of(pose, CHAINS), state, active)
    return matrices_of(pose)


def sliding(frames: int = 60, lift: tuple[int, int] | None = None) -> tuple[torch.Tensor, torch.Tensor]:
    """A body whose root drifts 1 mm a frame over straight legs; the left knee lifts during `lift`."""
    turns = torch.zeros(1, frames, HUMANOID.joints, 3)
    turns[..., HUMANOID.index("leftUpperLeg"), 0] = -0.15
    turns[..., HUMANOID.index("leftLowerLeg"), 0] = 0.30
    turns[..., HUMANOID.index("rightUpperLeg"), 0] = -0.15
    turns[..., HUMANOID.index("rightLowerLeg"), 0] = 0.30
    if lift:
        rise = torch.sin(torch.linspace(0, math.pi, lift[1] - lift[0]))
        turns[:, lift[0] : lift[1], HUMANOID.index("leftUpperLeg"), 0] -= rise
        turns[:, lift[0] : lift[1], HUMANOID.index("leftLowerLeg"), 0] += rise
    for side in ("left", "right"):
        legs = (
            turns[..., HUMANOID.index(f"{side}UpperLeg"), 0]
            + turns[..., HUMANOID.index(f"{side}LowerLeg"), 0]
        )
        turns[..., HUMANOID.index(f"{side}Foot"), 0] = -legs
    rotations = matrix_from_axis_angle(turns)
    root = torch.zeros(1, frames, 3)
    low = forward_kinematics(HUMANOID, rotations[:, :1], root[:, :1]).positions[0, 0, BALLS, 1].min()
    root[..., 1] = 0.02 - low
    root[..., 0] = torch.arange(frames) * 0.001
    return rotations, root


def balls(rotations: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    return forward_kinematics(HUMANOID, rotations, root).positions[0, :, BALLS]


def test_feet_that_slid_stand_and_keep_their_direction() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    before, after = balls(rotations, root), balls(held, root)
    assert (before[1:] - before[:-1]).norm(dim=-1).mean() > 9e-4
    assert (after[1:] - after[:-1]).norm(dim=-1).max() < 1e-4
    world = [
        forward_kinematics(HUMANOID, r, root).rotations[0, :, HUMANOID.index("leftFoot")]
        for r in (rotations, held)
    ]
    assert angle_between(*world).max() < 1e-3


def test_a_lifted_foot_is_let_go_without_a_jump_and_returns_to_its_path() -> None:
    rotations, root = sliding(lift=(30, 50))
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    gap = (balls(held, root) - balls(rotations, root))[:, 0].norm(dim=-1)
    assert gap[29] > 0.02  # held back by then
    assert gap[45] < 0.004  # on its path at the top of the step
    shift = (balls(held, root) - balls(rotations, root))[:, 0]
    assert (shift[1:] - shift[:-1]).norm(dim=-1).max() < 0.0167  # half a metre per second


def test_a_foot_that_shuffles_steps_instead() -> None:
    """The whole body glides 0.4 m in 0.4 s with both feet flat: while they travel they are off the floor."""
    rotations, root = sliding()
    root[0, :, 0] = ((torch.arange(root.shape[1]) - 24) / 12).clamp(0, 1) * 0.4
    feet = Feet(HUMANOID, CHAINS)
    moved = balls(step(feet, rotations, root, feet.init_state(1)), root)
    standing = HUMANOID.rest_positions[BALLS, 1]
    assert (moved[30:34, :, 1] - standing).min() > 0.025
    assert (moved[-1, :, 1] - standing).abs().max() < 0.005
    assert (moved[10:20, :, 0] - moved[10:11, :, 0]).abs().max() < 1e-3


def test_nothing_else_moves() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    legs = [i for i, name in enumerate(HUMANOID.names) if name.endswith(("Leg", "Foot"))]
    others = [i for i in range(52) if i not in legs]
    torch.testing.assert_close(held[:, :, others], rotations[:, :, others], atol=1e-6, rtol=0)


@pytest.mark.parametrize("cuts", [[8] * 7 + [4], [1, 30, 29], [60]])
def test_any_chunking_gives_the_whole(cuts: list[int]) -> None:
    rotations, root = sliding(lift=(20, 40))
    feet = Feet(HUMANOID, CHAINS)
    state = feet.init_state(1)
    pieces = zip(rotations.split(cuts, 1), root.split(cuts, 1), strict=True)
    parts = torch.cat([step(feet, *piece, state) for piece in pieces], 1)
    torch.testing.assert_close(parts, step(feet, rotations, root, feet.init_state(1)))


def test_idle_rows_stay_untouched() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    state = feet.init_state(2)
    both = rotations.expand(2, -1, -1, -1, -1), root.expand(2, -1, -1)
    step(feet, *both, state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.tensors())


def test_a_rig_without_feet_is_passed_through() -> None:
    footless = Feet(Skeleton(HUMANOID.config.model_copy(update={"feet": ()})), CHAINS)
    pose = to_lanes(*sliding())
    before = pose.turns.copy()
    footless.step(pose, legs_of(pose, CHAINS), footless.init_state(1))
    assert np.array_equal(pose.turns, before)
