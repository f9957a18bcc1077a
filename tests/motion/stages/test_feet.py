import math

import numpy as np
import pytest
from tests.motion.stages.poses import everyone, in_pieces, matrices_of, pose_of, quaternions_of

from echoavatar.motion.ik.limbs import Chains
from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import angle_between, matrix_from_axis_angle
from echoavatar.motion.stages.feet import (
    BACK,
    CLEAR,
    CLEARANCE,
    ENTER_HEIGHT,
    FADE,
    LARGEST,
    LEAVE_HEIGHT,
    LEAVE_SPEED,
    RISE,
    SETTLE,
    STANDING_SPEED,
    STEPPING_SPEED,
    Feet,
    FeetState,
)

BALLS = list(HUMANOID.config.feet)[1::2]
CHAINS = Chains(HUMANOID, list(HUMANOID.config.feet))


def step(
    feet: Feet,
    rotations: np.ndarray,
    root: np.ndarray,
    state: FeetState,
    active: np.ndarray | None = None,
    sizes: list[int] | None = None,
) -> np.ndarray:
    on = everyone(len(rotations)) if active is None else active

    def chunk(turns: np.ndarray, places: np.ndarray) -> np.ndarray:
        pose = pose_of(turns, places)
        largest = np.full(len(turns), LARGEST)
        feet.step(pose, CHAINS.pose(pose.rotations), state, on, decoded_root=pose.root, largest=largest)
        return matrices_of(pose)

    return in_pieces(chunk, rotations, root, sizes=sizes)


def sliding(frames: int = 60, lift: tuple[int, int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A body whose root drifts 1 mm a frame over straight legs; the left knee lifts during `lift`."""
    turns = np.zeros((1, frames, HUMANOID.joints, 3), np.float32)
    turns[..., HUMANOID.index("leftUpperLeg"), 0] = -0.15
    turns[..., HUMANOID.index("leftLowerLeg"), 0] = 0.30
    turns[..., HUMANOID.index("rightUpperLeg"), 0] = -0.15
    turns[..., HUMANOID.index("rightLowerLeg"), 0] = 0.30
    if lift:
        rise = np.sin(np.linspace(0, math.pi, lift[1] - lift[0]))
        turns[:, lift[0] : lift[1], HUMANOID.index("leftUpperLeg"), 0] -= rise
        turns[:, lift[0] : lift[1], HUMANOID.index("leftLowerLeg"), 0] += rise
    for side in ("left", "right"):
        legs = turns[..., HUMANOID.index(f"{side}UpperLeg"), 0] + turns[..., HUMANOID.index(f"{side}LowerLeg"), 0]
        turns[..., HUMANOID.index(f"{side}Foot"), 0] = -legs
    rotations = matrix_from_axis_angle(turns)
    root = np.zeros((1, frames, 3), np.float32)
    low = forward_kinematics(HUMANOID, rotations[:, :1], root[:, :1]).positions[0, 0, BALLS, 1].min()
    root[..., 1] = 0.02 - low
    root[..., 0] = np.arange(frames) * 0.001
    return rotations, root


def balls(rotations: np.ndarray, root: np.ndarray) -> np.ndarray:
    return forward_kinematics(HUMANOID, rotations, root).positions[0][:, BALLS]


def test_feet_that_slid_stand_and_keep_their_direction() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    before, after = balls(rotations, root), balls(held, root)
    assert np.linalg.norm(before[1:] - before[:-1], axis=-1).mean() > 9e-4
    assert np.linalg.norm(after[1:] - after[:-1], axis=-1).max() < 1e-4
    world = [
        forward_kinematics(HUMANOID, r, root).rotations[0, :, HUMANOID.index("leftFoot")] for r in (rotations, held)
    ]
    assert angle_between(*world).max() < 1e-3


def test_a_lifted_foot_is_let_go_without_a_jump_and_returns_to_its_path() -> None:
    rotations, root = sliding(lift=(30, 50))
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    gap = np.linalg.norm((balls(held, root) - balls(rotations, root))[:, 0], axis=-1)
    assert gap[29] > 0.02  # held back by then
    assert gap[45] < 0.004  # on its path at the top of the step
    shift = (balls(held, root) - balls(rotations, root))[:, 0]
    assert np.linalg.norm(shift[1:] - shift[:-1], axis=-1).max() < 0.0167  # half a metre per second


def test_a_foot_that_is_let_go_rises_before_it_goes() -> None:
    """Played slowly, each frame is many: a way across the floor that is made near it would be seen as sliding."""
    rotations, root = sliding()
    root[0, :, 0] = np.clip((np.arange(root.shape[1]) - 24) / 12, 0, 1) * 0.4
    feet = Feet(HUMANOID, CHAINS)
    moved = balls(step(feet, rotations, root, feet.init_state(1)), root)
    high = moved[..., 1] - HUMANOID.rest_positions[BALLS, 1]
    way = np.linalg.norm(moved[1:, :, ::2] - moved[:-1, :, ::2], axis=-1)
    lifts = (high[1:] > 0.01) & (high[:-1] < 0.005)
    assert lifts.sum() == 2  # each foot once
    assert (way < high[1:] - high[:-1])[lifts].all()  # it rises by more than it travels
    assert way.max() > 0.03


def test_a_foot_that_shuffles_steps_instead() -> None:
    """The whole body glides 0.4 m in 0.4 s with both feet flat: while they travel they are off the floor."""
    rotations, root = sliding()
    root[0, :, 0] = np.clip((np.arange(root.shape[1]) - 24) / 12, 0, 1) * 0.4
    feet = Feet(HUMANOID, CHAINS)
    moved = balls(step(feet, rotations, root, feet.init_state(1)), root)
    standing = HUMANOID.rest_positions[BALLS, 1]
    assert (moved[30:34, :, 1] - standing).min() > 0.025
    assert np.abs(moved[-1, :, 1] - standing).max() < 0.005
    assert np.abs(moved[10:20, :, 0] - moved[10:11, :, 0]).max() < 1e-3


def glide(height: list[float], speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Balls (t, 2, 3) as shown and as decoded, of a body that floats at a height over its stance and glides along X."""
    rotations, root = sliding(len(height))
    standing = HUMANOID.rest_positions[BALLS, 1]
    root[..., 1] += np.array(height) - (balls(rotations, root)[0, :, 1] - standing).min()
    root[..., 0] = np.arange(len(height)) * speed / 30
    feet = Feet(HUMANOID, CHAINS)
    ways = balls(step(feet, rotations, root, feet.init_state(1)), root), balls(rotations, root)
    shown, decoded = ((way - standing[:, None] * np.array([0.0, 1.0, 0.0])) for way in ways)
    return shown, decoded


def speed_of(way: np.ndarray) -> np.ndarray:
    """Along X, of the left ball, metres per second."""
    return np.asarray(np.diff(way[:, 0, 0]) * 30)


@pytest.mark.parametrize(("height", "speed", "stands"), [(0.01, 0.1, True), (0.03, 0.1, False), (0.0, 0.2, True)])
def test_a_foot_is_planted_where_it_is_low_and_slow(height: float, speed: float, stands: bool) -> None:
    """Decoded one centimetre over the floor it stands, at three it travels; up to 20 cm/s are an error, no step."""
    shown, decoded = glide([height] * 12, speed)
    assert np.ptp(shown[:, 0, 0]) < 1e-3 if stands else np.array_equal(shown[:, :, 0], decoded[:, :, 0])


@pytest.mark.parametrize(("height", "stands"), [(0.028, True), (0.045, False)])
def test_a_planted_foot_is_let_go_where_it_is_decoded_well_above_the_floor(height: float, stands: bool) -> None:
    """It is raised within half a second and stays there, while the body glides on at 10 cm/s."""
    shown, _ = glide([0.0] * 8 + np.linspace(0, height, 15).tolist() + [height] * 5, 0.1)
    assert (np.abs(speed_of(shown)[20:]).max() < 0.02) == stands


def test_a_body_that_bobs_stands_and_its_soles_settle() -> None:
    """Up and down by 12 mm, 2.5 times a second; and a body decoded a centimetre too high."""
    bobbing, _ = glide((0.006 - 0.006 * np.cos(np.arange(24) / 30 * 2 * math.pi * 2.5)).tolist(), 0.1)
    assert np.ptp(bobbing[:, 0, 0]) < 1e-3
    floating, _ = glide([0.01] * 24, 0.0)
    assert floating[15:, :, 1].max() < 1e-3


def test_a_foot_steps_higher_the_faster_it_goes() -> None:
    """Dragged at half a metre a second it is raised by two centimetres, at a brisk step by more than four."""
    heights = [glide([0.0] * 36, speed)[0][-1, 0, 1] for speed in (0.5, 0.8)]
    assert 0.012 < heights[0] < 0.025
    assert 0.04 < heights[1] < 0.05


def test_a_foot_that_is_held_too_long_steps_to_its_place_within_half_a_second() -> None:
    """A body that glides at 10 cm/s: its feet step after 12 cm, and land a centimetre or so from where they belong."""
    shown, decoded = glide([0.0] * 60, 0.1)
    speed, away = speed_of(shown), np.abs(shown - decoded)[:, 0, 0]
    on_its_way = np.flatnonzero(speed > 0.05)
    begin, end = on_its_way[0], on_its_way[-1] + 1
    assert 0.11 < away[begin] < 0.13
    assert 0.005 < away[end] < 0.016
    assert end - begin < 15


def test_nothing_else_moves() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    held = step(feet, rotations, root, feet.init_state(1))
    legs = [i for i, name in enumerate(HUMANOID.names) if name.endswith(("Leg", "Foot"))]
    others = [i for i in range(52) if i not in legs]
    np.testing.assert_allclose(held[:, :, others], rotations[:, :, others], atol=1e-6, rtol=0)


@pytest.mark.parametrize("sizes", [[8] * 7 + [4], [1, 7, 5, 8, 3, 8, 8, 8, 8, 4], [1] * 60])
def test_any_chunking_gives_the_whole(sizes: list[int]) -> None:
    """Outside witness: `walked`, which knows no chunks and holds feet by the forward kinematics of whole clips."""
    rotations, root = sliding(lift=(20, 40))
    feet = Feet(HUMANOID, CHAINS)
    shown = balls(step(feet, rotations, root, feet.init_state(1), sizes=sizes), root)
    wanted = walked(balls(rotations, root).astype(np.float64))
    np.testing.assert_allclose(shown, wanted, atol=2e-4)
    assert np.abs(wanted - balls(rotations, root)).max() > 0.02


def walked(decoded: np.ndarray) -> np.ndarray:
    """Where the balls (t, 2, 3) should be, frame by frame in plain words."""
    shown = decoded.copy()
    standing = HUMANOID.rest_positions[BALLS, 1]
    for foot in range(2):
        is_held, aside, up, place = False, np.zeros(2), 0.0, decoded[0, foot, ::2]
        for t, now in enumerate(decoded[:, foot]):
            before = decoded[max(t - 1, 0), foot]
            height, across = now[1] - standing[foot], now[::2] - before[::2]
            may_stay = height < LEAVE_HEIGHT and (now[1] - before[1]) * 30 < LEAVE_SPEED
            haste = (np.linalg.norm(across) * 30 - STANDING_SPEED) / (STEPPING_SPEED - STANDING_SPEED)
            was_held, low = is_held, before[1] - standing[foot] + up
            is_held = may_stay and (is_held or (height < ENTER_HEIGHT and bool(haste < 0)))
            if is_held:
                aside = place - now[::2]
                up += SETTLE * (-height - up)
            else:
                far = np.linalg.norm(aside)
                lift = CLEARANCE * min(haste, 1) - height if haste > 0 else 0.0
                lift = max(lift, min(2 * far, CLEARANCE) - height) if far > BACK else lift
                up = up + RISE * (lift - up) if lift > 0 else FADE * up
                if was_held:
                    share = np.clip((height + up) / CLEAR, 0, 1)
                    aside = share * aside + (1 - share) * (place - now[::2])
                aside = aside * (1 - (1 - FADE) * np.clip(low / CLEAR, 0, 1))
            place = now[::2] + aside
            shown[t, foot] = place[0], now[1] + up, place[1]
    return shown


def test_a_foot_that_sinks_while_it_is_held_stays() -> None:
    """It was let go when it moved fast, down as well as up, and slid over the floor to where it was decoded."""
    rotations, root = sliding()
    root[0, 30, 1] += 0.015  # up gently, down at 45 cm/s
    root[0, 29, 1] += 0.008
    feet = Feet(HUMANOID, CHAINS)
    moved = balls(step(feet, rotations, root, feet.init_state(1)), root)
    assert np.linalg.norm(moved[1:, :, ::2] - moved[:-1, :, ::2], axis=-1).max() < 2e-4


def test_a_foot_is_set_down_where_it_was_shown() -> None:
    """Not where it is decoded in the frame in which it comes to stand, a frame's travel further on."""
    rotations, root = sliding(lift=(30, 50))
    feet = Feet(HUMANOID, CHAINS)
    moved = balls(step(feet, rotations, root, feet.init_state(1)), root)[:, 0]
    slides = np.linalg.norm(moved[1:, ::2] - moved[:-1, ::2], axis=-1)
    down = 50 + int(np.flatnonzero(slides[50:] < 5e-5)[0])
    assert slides[down:].max() < 1e-4


def test_idle_rows_stay_untouched() -> None:
    rotations, root = sliding()
    feet = Feet(HUMANOID, CHAINS)
    state = feet.init_state(2)
    both = np.concatenate([rotations] * 2), np.concatenate([root] * 2)
    step(feet, *both, state, np.array([True, False]))
    assert all(not tensor[1].any() for tensor in state.arrays())


def test_a_rig_without_feet_is_passed_through() -> None:
    footless = Feet(Skeleton(HUMANOID.config.model_copy(update={"feet": ()})), CHAINS)
    pose = pose_of(*sliding(8))
    before = quaternions_of(pose)
    state, how = footless.init_state(1), {"decoded_root": pose.root, "largest": np.full(1, LARGEST)}
    footless.step(pose, CHAINS.pose(pose.rotations), state, everyone(1), **how)
    assert np.array_equal(quaternions_of(pose), before)
