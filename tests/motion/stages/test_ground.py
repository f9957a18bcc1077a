import math

import numpy as np
import pytest
from tests.motion.stages.poses import everyone, in_pieces, pose_of, root_of

from echoavatar.motion.ik.limbs import Chains
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar.motion.stages.ground import RELEASE_HEIGHT, Ground, GroundState

CHAINS = Chains(HUMANOID, list(HUMANOID.config.feet))


def walk(frames: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """A pendulum of stiff legs: the pelvis rocks over planted feet, with wrong root velocities on top."""
    angle = 0.04 * np.sin(np.arange(frames) * 2 * math.pi / 24)
    turns = np.zeros((1, frames, HUMANOID.joints, 3), np.float32)
    for side in ("left", "right"):
        turns[:, :, HUMANOID.index(f"{side}UpperLeg"), 0] = angle
        turns[:, :, HUMANOID.index(f"{side}Foot"), 0] = -angle
    travel = np.zeros((1, frames, 3), np.float32)
    travel[..., 0] = 0.004  # the decoded velocity says: drift 4 mm a frame
    travel[..., 2] = 0.95 - 0.83 * (1 - np.cos(angle))
    return matrix_from_axis_angle(turns), travel


def step(
    ground: Ground,
    rotations: np.ndarray,
    travel: np.ndarray,
    state: GroundState,
    active: np.ndarray | None = None,
    sizes: list[int] | None = None,
) -> np.ndarray:
    """World positions of the root; `travel` is [vx, vz, height]."""
    on = everyone(len(rotations)) if active is None else active

    def chunk(turns: np.ndarray, way: np.ndarray) -> np.ndarray:
        pose = pose_of(turns, way[..., [0, 2, 1]])
        ground.step(pose, CHAINS.pose(pose.rotations), state, on)
        return root_of(pose)

    return in_pieces(chunk, rotations, travel, sizes=sizes)


def foot_path(rotations: np.ndarray, root: np.ndarray) -> np.ndarray:
    return forward_kinematics(HUMANOID, rotations, root).positions[:, :, list(HUMANOID.config.feet)]


def test_planted_feet_stay_where_they_are() -> None:
    rotations, travel = walk()
    ground = Ground(HUMANOID, CHAINS)
    root = step(ground, rotations, travel, ground.init_state(1))
    feet = foot_path(rotations, root)
    assert np.linalg.norm(feet[:, 1:, :, [0, 2]] - feet[:, :-1, :, [0, 2]], axis=-1).max() < 1e-4
    assert (
        np.abs(feet[..., 1] - HUMANOID.rest_positions[list(HUMANOID.config.feet), 1]).max() < 0.002
    )  # and neither float nor sink


def test_in_the_air_the_decoded_velocity_counts() -> None:
    rotations, travel = walk()
    travel[..., 2] += 0.3
    ground = Ground(HUMANOID, CHAINS)
    root = step(ground, rotations, travel, ground.init_state(1))
    np.testing.assert_allclose(root[:, 1:, 0] - root[:, :-1, 0], travel[:, 1:, 0], atol=1e-5)
    np.testing.assert_allclose(root[..., 1], travel[..., 2], atol=1e-5)


@pytest.mark.parametrize(("speed", "share"), [(0.3, 0.0), (0.55, 0.5), (0.7, 0.896), (0.8, 1.0)])
def test_a_low_foot_that_travels_faster_than_errors_do_is_not_planted(speed: float, share: float) -> None:
    """Standing legs that glide, as in a dancer's low step."""
    rotations, travel = (
        np.broadcast_to(np.eye(3, dtype=np.float32), (1, 24, HUMANOID.joints, 3, 3)),
        np.zeros((1, 24, 3), np.float32),
    )
    travel[..., 0], travel[..., 2] = speed / 30, 0.95
    ground = Ground(HUMANOID, CHAINS)
    way = step(ground, rotations, travel, ground.init_state(1))[0, -1, 0]
    np.testing.assert_allclose(way, np.array(share * 23 * speed / 30), atol=1e-4, rtol=0)


@pytest.mark.parametrize(("height", "least", "most"), [(0.005, 0.0, 0.1), (0.04, 0.99, 1.01)])
def test_feet_hold_the_root_until_they_are_a_few_centimetres_up(height: float, least: float, most: float) -> None:
    """Standing legs that drift by 10 cm/s: half a centimetre over the floor they hold, at four they have let go."""
    rotations, travel = (
        np.broadcast_to(np.eye(3, dtype=np.float32), (1, 24, HUMANOID.joints, 3, 3)),
        np.zeros((1, 24, 3), np.float32),
    )
    travel[..., 0], travel[..., 2] = 0.1 / 30, 0.95 + height
    ground = Ground(HUMANOID, CHAINS)
    way = step(ground, rotations, travel, ground.init_state(1))[0, -1, 0] / (23 * 0.1 / 30)
    assert least <= way <= most


@pytest.mark.parametrize("sizes", [[8] * 6, [1, 7, 8, 3, 5, 8, 8, 8], [1] * 48])
def test_any_chunking_gives_the_whole(sizes: list[int]) -> None:
    """Outside witness: `rolled`, frame by frame in double precision."""
    rotations, travel = walk()
    travel[:, 20:30, 2] += 0.02  # off the floor by less than where it lets go
    ground = Ground(HUMANOID, CHAINS)
    shown = step(ground, rotations, travel, ground.init_state(1), sizes=sizes)[0]
    points = foot_path(rotations, np.zeros_like(travel))[0].astype(np.float64)
    np.testing.assert_allclose(shown, rolled(points, travel[0].astype(np.float64)), atol=2e-6)


def rolled(points: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Roots (t, 3) over points (t, p, 3) that are relative to them; travel is [vx, vz, height]."""
    rest = HUMANOID.rest_positions[list(HUMANOID.config.feet), 1].astype(np.float64)
    place, roots, before, last = np.zeros(2), [], points[0], None
    for now, (vx, vz, height) in zip(points, travel, strict=True):
        over = now[:, 1] + height - rest
        share = np.clip(over / RELEASE_HEIGHT, 0, 1)
        weight = 1 - share**2 * (3 - 2 * share)
        both = np.minimum(weight, weight if last is None else last)
        held = ((both**4)[:, None] * (before - now)[:, ::2]).sum(0) / max((both**4).sum(), 1e-6)
        decoded = np.array([vx, vz])
        if last is not None:
            place = place + decoded + both.max() * (held - decoded)
        sinking = (weight**4 * over).sum() / max((weight**4).sum(), 1e-6)
        roots.append([place[0], height - weight.max() * sinking, place[1]])
        before, last = now, weight
    return np.array(roots)


def test_idle_rows_do_not_move_and_neighbours_do_not_matter() -> None:
    rotations, travel = walk()
    ground = Ground(HUMANOID, CHAINS)
    state = ground.init_state(2)
    both = (np.concatenate([rotations] * 2), np.concatenate([travel] * 2))
    first = step(ground, *both, state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.arrays())
    alone = step(ground, rotations, travel, ground.init_state(1))
    assert np.array_equal(first[:1], alone)
