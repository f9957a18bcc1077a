"""Who has danced away steps back to her place: feet stand or are lifted, and sound finds her with both on the floor."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.motion.test_idle_motion import positions, standing

from echoavatar.motion.homecoming import DIP, FAR, HOME, SIDESTEP, STRIDE, WAIT_S, Homecoming
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar_lab.data.faults import skate

FEET = ("leftToes", "rightToes", "leftFoot", "rightFoot")
FLOOR = HUMANOID.rest_positions[[HUMANOID.index(foot) for foot in FEET], 1]
SECONDS = 8 / 30  # of a chunk


def away(x: float, z: float, turned: float = 0.0) -> MotionChunk:
    """A chunk of standing there, with knees a little bent."""
    bent = {f"{side}{leg}": (turn, 0, 0) for side in ("left", "right") for leg, turn in BENT.items()}
    chunk = standing(hips=(0, turned, 0), **bent)
    return chunk._replace(root=chunk.root + np.float32([x, -0.016, z]))


BENT = {"UpperLeg": -11, "LowerLeg": 22, "Foot": -11}


def live(
    chunk: MotionChunk, chunks: int, is_idle: Callable[[int], bool] = lambda _: True, **options: Any
) -> MotionChunk:
    home = Homecoming(HUMANOID, MotionOptions(**options))
    return join([home.apply(number, chunk, is_idle=is_idle(number)) for number in range(chunks)])


def feet(motion: MotionChunk) -> np.ndarray:
    place = positions(motion)
    return np.stack([place[foot] for foot in FEET], 1)


@pytest.mark.parametrize(
    ("x", "z", "turned"), [(0, 3, 0), (1.6, 0, 0), (-1.2, -2.5, 0), (0.4, 0.1, 50), (1, 1, 180)], ids=str
)
def test_she_steps_home_and_no_foot_slides(x: float, z: float, turned: float) -> None:
    made = live(away(x, z, turned), 64)
    assert np.hypot(*made.root[-1, [0, 2]]) < HOME + 0.01
    place = feet(made)
    slides = skate(place[:, :2], 30, standing_height=FLOOR[:2])
    assert slides < 0.05  # centimetres per second
    moves = np.linalg.norm(np.diff(place[..., ::2], axis=0), axis=-1)
    lifted = place[1:, :2, 1] - FLOOR[:2]
    assert lifted[moves[:, :2] > 0.01].min() > 0.015  # what travels is in the air
    assert ((moves[:, :2] < 1e-3).any(1)).all()  # one foot stands
    assert lifted.min() > -0.005
    paces = np.linalg.norm(place[-1, 0] - place[0, 0]) / STRIDE + abs(x) / SIDESTEP
    assert len(made.root) / 30 > WAIT_S + 0.3 * paces
    down = made.root[0, 1] - made.root[:, 1].min()
    assert down == pytest.approx(DIP, abs=0.01)
    turns = made.rotations[:, [HUMANOID.index(name) for name in ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg")]]
    half = np.arccos(np.clip(np.abs((turns[1:] * turns[:-1]).sum(-1)), 0, 1))
    assert np.degrees(2 * half).max() * 30 < 500  # no knee snaps


def test_feet_do_not_cross_on_the_way_to_a_side() -> None:
    place = positions(live(away(-2, 0), 60))
    assert (place["leftFoot"][:, 0] - place["rightFoot"][:, 0]).min() > 0.05


def test_sound_finds_her_on_both_feet_and_the_rest_of_the_way_is_made_in_the_next_pause() -> None:
    made = live(away(0, 3), 84, lambda number: not 16 <= number < 34)
    place, stop = feet(made), 16 * 8
    assert 0.3 < made.root[stop, 2] < 2.7
    lands = slice(stop + 35, 34 * 8)  # a step that goes on and one that joins it
    assert np.ptp(place[lands], axis=0).max() < 1e-4
    np.testing.assert_allclose(place[lands][0, 0, 2], place[lands][0, 1, 2], atol=1e-4)
    assert np.hypot(*made.root[-1, [0, 2]]) < HOME + 0.01


def test_a_chunk_that_is_made_again_is_the_same() -> None:
    home = Homecoming(HUMANOID)
    first = [home.apply(number, away(1, 2), is_idle=True) for number in range(20)]
    again = [home.apply(number, away(1, 2), is_idle=True) for number in range(10, 20)]
    np.testing.assert_array_equal(join(first[10:]).rotations, join(again).rotations)
    np.testing.assert_array_equal(join(first[10:]).root, join(again).root)


@pytest.mark.parametrize(
    ("motion", "is_idle", "options"),
    [
        (away(0, FAR - 0.01), True, {}),
        (away(0, 3), False, {}),
        (away(0, 3), True, {"leash_m": 4.0}),
        (away(0, 3), True, {"in_place": True}),
        (away(0, 3)._replace(rotations=live(away(0, 3), 14).rotations[-8:]), True, {}),
    ],
    ids=["near", "in sound", "on a leash", "in place", "legs that move"],
)
def test_else_she_stays(motion: MotionChunk, is_idle: bool, options: dict[str, Any]) -> None:
    made = live(motion, 20, lambda _: is_idle, **options)
    np.testing.assert_array_equal(made.root[-8:], motion.root)
    np.testing.assert_array_equal(made.rotations[-8:], motion.rotations)


def test_a_rig_without_known_feet_stays() -> None:
    rig = HUMANOID.config.model_copy(update={"feet": ()})
    home = Homecoming(type(HUMANOID)(rig))
    assert all(home.apply(number, away(0, 3), is_idle=True).root[0, 2] == 3 for number in range(20))
