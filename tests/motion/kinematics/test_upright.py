"""Unit, up and facing are measured on the figure, and put right."""

from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.rotations import quaternion_multiply
from echoavatar.motion.kinematics.upright import UNITS, Stand, axes_of, measure, metres_of, of_clip, righted, turned

PERSON = swaying(4)
QUARTER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # Y up, facing +Z, becomes Z up, facing -Y
SIDEWAYS = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # facing +X
STILL = np.eye(3)
MIRROR = np.diag([1.0, 1, -1])  # as programs with a left-handed world write, which do not turn it


@pytest.mark.parametrize(
    ("rest", "world", "said"),
    [
        (QUARTER, QUARTER, "it is turned to Y up"),
        (STILL, QUARTER, "its motion is turned"),
        (QUARTER, STILL, "its rest pose is turned"),
        (SIDEWAYS, SIDEWAYS, "it is turned"),
        (QUARTER @ SIDEWAYS, QUARTER @ SIDEWAYS, "it is turned"),
        (QUARTER @ SIDEWAYS @ SIDEWAYS, QUARTER @ SIDEWAYS @ SIDEWAYS, "it is turned"),
        (QUARTER @ QUARTER, QUARTER @ QUARTER, "it is turned"),
        (MIRROR, MIRROR, "it is mirrored"),
        (MIRROR @ SIDEWAYS @ SIDEWAYS, MIRROR @ SIDEWAYS @ SIDEWAYS, "it is mirrored"),
        (QUARTER @ MIRROR, QUARTER @ MIRROR, "it is mirrored"),
        (MIRROR, QUARTER @ MIRROR, "it is mirrored"),
        (STILL, STILL, ""),
    ],
)
def test_a_figure_is_turned_upright_and_to_the_front(rest, world, said, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    made = turned(PERSON, rest, world)
    np.testing.assert_allclose(made.pose().positions, PERSON.pose().positions @ world.T, atol=1e-5)
    write_bvh(tmp_path / "a.bvh", made.skeleton, made.rotations, made.root, 30)
    motion = read_bvh(tmp_path / "a.bvh")
    assert said in caplog.text
    assert (not said) == (not caplog.text)
    np.testing.assert_allclose(motion.pose().positions, PERSON.pose().positions, atol=2e-5, rtol=0)
    np.testing.assert_allclose(motion.skeleton.offsets[1:], HUMANOID.offsets[1:], atol=2e-5, rtol=0)


def about_y(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


@pytest.mark.parametrize("angle", [0.01, 0.3, 0.8, -2.0])
def test_a_figure_may_face_between_two_axes(angle: float) -> None:
    made = turned(PERSON, about_y(angle), about_y(angle))
    stand = of_clip(made, HUMANOID.config.vrm)
    np.testing.assert_allclose(stand.rest, about_y(-angle), atol=1e-3)
    places = righted(made, stand._replace(metres=1.0)).pose().positions
    np.testing.assert_allclose(places, PERSON.pose().positions, atol=2e-3, rtol=0)
    assert bool(stand.notes(stand.metres)) == (abs(angle) > 0.1)


PLACES = {bone: HUMANOID.rest_positions[joint].astype(np.float64) for bone, joint in HUMANOID.config.vrm.items()}


@pytest.mark.parametrize("turn", [STILL, QUARTER, about_y(0.5), np.diag([-1.0, 1, 1]), QUARTER @ np.diag([1.0, 1, -1])])
def test_the_axes_of_a_figure_are_found_turned_or_mirrored(turn: np.ndarray) -> None:
    places = {bone: turn @ place for bone, place in PLACES.items()}
    np.testing.assert_allclose(axes_of(places, [turn]) @ turn, np.eye(3), atol=1e-9)


def test_a_figure_in_one_place_has_no_axes() -> None:
    with pytest.raises(MotionError, match="in one place; pose it"):
        axes_of({bone: 0 * place for bone, place in PLACES.items()})


@pytest.mark.parametrize(
    ("tall", "stated", "metres"),
    [(1.7, 1.0, 1.0), (0.6, 1.0, 1.0), (170, 1.0, 0.01), (170, 0.01, 0.01), (5e6, 1.0, None)],
)
def test_the_stated_unit_holds_if_it_makes_a_person(tall: float, stated: float, metres: float | None) -> None:
    assert metres_of(tall, stated) == pytest.approx(1.7 / tall if metres is None else metres)


def resized(motion: Motion, size: float) -> Motion:
    return turned(motion, STILL, STILL, size)


@pytest.mark.parametrize(
    ("tall", "per_metre", "unit"),
    [
        (1.7, 100, ""),
        (0.9, 100, ""),
        (2.5, 100, ""),
        (3.0, 100, ""),
        (0.55, 100, ""),
        (4.0, 100, ""),
        (3.5, 1, "metres"),
        (8.0, 1, "metres"),
        (0.65, 100, None),  # a creature, or a person of 1.65 m in inches: the unit is said
        (0.9, 1, "metres"),
        (1.7, 1, "metres"),
        (2.5, 1, "metres"),
        (0.6, 1, "metres"),
        (1.7, 1000, "millimetres"),
        (1.2, 1000, "millimetres"),
        (1.7, 1 / 0.0254, "inches"),
        (1.5, 1 / 0.0254, "inches"),
        (2.0, 1 / 0.0254, "inches"),
        (1.7, 1 / 0.3048, "feet"),
        (1.5, 1 / 0.0564444, "CMU"),
        (2.0, 1 / 0.0564444, "CMU"),
        (1.7, 0.1, "tens of metres"),
        (1.7, 0.01, "hundreds of metres"),
        (1.7, 10, "decimetres"),
        (6.0, 100, ""),
    ],
)
def test_the_unit_is_the_likeliest_of_those_that_occur(tall, per_metre, unit, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    made = resized(PERSON, tall / 1.7)
    write_bvh(tmp_path / "a.bvh", made.skeleton, made.rotations, made.root, 30, stand=Stand(metres=1 / per_metre))
    motion = read_bvh(tmp_path / "a.bvh")
    if unit is not None:
        atol = 1e-5 if per_metre >= 1 else 1e-3  # the file has six digits
        np.testing.assert_allclose(motion.root, made.root, atol=atol)
        np.testing.assert_allclose(motion.skeleton.offsets, made.skeleton.offsets, atol=atol, rtol=0)
    assert ("its unit is taken for" in caplog.text) == (unit != "")
    assert (unit or "") in caplog.text


def test_an_unheard_of_unit_makes_a_person_of_the_figure(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = resized(PERSON, 37.0)
    write_bvh(tmp_path / "a.bvh", made.skeleton, made.rotations, made.root, 30, stand=Stand(metres=0.001))
    motion = read_bvh(tmp_path / "a.bvh")
    assert "so that the figure is 1.70 m tall" in caplog.text
    np.testing.assert_allclose(motion.pose().positions, PERSON.pose().positions, atol=0.05)


@pytest.mark.parametrize("times", [10, 100, 1000])
def test_hips_that_fly_because_their_keys_have_another_unit_come_down(times, tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    write_bvh(tmp_path / "a.bvh", PERSON.skeleton, PERSON.rotations, times * PERSON.root, 30)
    motion = read_bvh(tmp_path / "a.bvh")
    np.testing.assert_allclose(motion.root, PERSON.root, atol=1e-5)
    assert f"its hips are {times} times as high as its legs are long" in caplog.text


def test_hips_far_above_the_origin_stay_there(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = PERSON.root + np.array([0, 38, 0], np.float32)
    write_bvh(tmp_path / "a.bvh", PERSON.skeleton, PERSON.rotations, root, 30)
    np.testing.assert_allclose(read_bvh(tmp_path / "a.bvh").root, root, atol=1e-4)
    assert not caplog.text


@pytest.mark.parametrize("down", [0.6, 0.95, 3.0])
def test_a_person_in_the_floor_is_lifted_onto_it(down: float, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As in clips without a height, whose hips stay at the origin."""
    root = PERSON.root - np.array([0, down, 0], np.float32)
    write_bvh(tmp_path / "a.bvh", PERSON.skeleton, PERSON.rotations, root, 30)
    raised = read_bvh(tmp_path / "a.bvh").root - root
    np.testing.assert_allclose(raised, np.broadcast_to(raised[0], raised.shape), atol=1e-5)
    np.testing.assert_allclose(raised[0], [0, down, 0], atol=0.05)
    assert "below the floor, and it is lifted onto it" in caplog.text


def test_places_in_some_other_unit_are_refused(tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", PERSON.skeleton, PERSON.rotations, 300 * PERSON.root, 30)
    with pytest.raises(MotionError, match=r"a\.bvh: its hips move \d+ times its height a second"):
        read_bvh(tmp_path / "a.bvh")


def test_feet_that_point_back_in_the_rest_pose_alone_are_no_mirror() -> None:
    """Legs are turned by half a turn in every frame, and so they were at rest."""
    config, rotations = HUMANOID.config, PERSON.rotations.copy()
    offsets, half = np.array(config.offsets), np.diag([-1.0, 1, -1])
    below = [joint for joint, name in enumerate(HUMANOID.names) if name.endswith(("LowerLeg", "Foot", "Toes"))]
    offsets[below] = offsets[below] @ half
    thighs = [HUMANOID.index(f"{side}UpperLeg") for side in ("left", "right")]
    rotations[:, thighs] = quaternion_multiply(rotations[:, thighs], np.array([0.0, 0, 1, 0]))
    # turned about Y on both sides, the joints below keep their axes
    rotations[:, below, 1] *= -1
    rotations[:, below, 3] *= -1
    twisted = Motion(HUMANOID.with_offsets(offsets), rotations, PERSON.root, 30.0)
    places = PERSON.pose().positions
    np.testing.assert_allclose(twisted.pose().positions[:, below], places[:, below], atol=1e-4)
    stand = of_clip(twisted, config.vrm)
    np.testing.assert_allclose(righted(twisted, stand._replace(metres=1.0)).pose().positions, places, atol=1e-4)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.2, -1.0, 0.3), (0.0, 2.0, 1.0)])
def test_z_up_is_seen_wherever_the_floor_is(place: tuple[float, float, float], tmp_path: Path) -> None:
    made = turned(PERSON, STILL, QUARTER)
    made.root[:] += np.array(place, np.float32) - made.root[0]
    write_bvh(tmp_path / "a.bvh", made.skeleton, made.rotations, made.root, 30)
    places = read_bvh(tmp_path / "a.bvh").pose().positions
    assert (places[:, HUMANOID.index("head"), 1] - places[:, HUMANOID.index("leftFoot"), 1]).min() > 1.2


def test_who_lies_on_the_floor_is_not_stood_up(tmp_path, caplog) -> None:  # type: ignore[no-untyped-def]
    lying = turned(PERSON, STILL, QUARTER)
    lying.root[:] = [0.3, 0.1, -0.2]
    write_bvh(tmp_path / "a.bvh", lying.skeleton, lying.rotations, lying.root, 30)
    motion = read_bvh(tmp_path / "a.bvh")
    assert not caplog.text
    np.testing.assert_allclose(motion.root, lying.root, atol=1e-5)


@pytest.mark.parametrize(
    "turn", [STILL, QUARTER, SIDEWAYS, QUARTER @ SIDEWAYS, QUARTER.T, QUARTER @ QUARTER @ SIDEWAYS]
)
@pytest.mark.parametrize("per_metre", [1, 100, 1000])
def test_a_rest_pose_alone_tells_all(turn: np.ndarray, per_metre: float) -> None:
    places = HUMANOID.rest_positions @ turn.T * per_metre
    stand = measure(HUMANOID.config.vrm, places)
    np.testing.assert_array_equal(stand.rest @ turn, STILL)
    assert stand.metres == 1 / per_metre
    assert stand.tall == pytest.approx(1.7, abs=0.01)


def test_a_figure_that_does_not_stand_or_has_no_legs_is_left_as_it_is() -> None:
    lengths = np.linalg.norm(HUMANOID.offsets, axis=-1)
    places = np.cumsum(lengths)[:, None] * [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(measure(HUMANOID.config.vrm, places).rest, STILL)
    for part in ("Leg", "Arm", "head"):
        without = {bone: joint for bone, joint in HUMANOID.config.vrm.items() if part not in bone}
        assert measure(without, HUMANOID.rest_positions @ QUARTER.T, 1.0).notes(usual=1.0) == []
    for place in (0.0, np.inf, np.nan):
        assert measure(HUMANOID.config.vrm, np.full_like(places, place)).notes() == []


def test_a_twisted_rest_pose_keeps_its_facing() -> None:
    """Hips along Z and shoulders along -Z, as in some files of ACCAD: nothing says where it faces."""
    places = HUMANOID.rest_positions @ SIDEWAYS.T
    arms = [joint for bone, joint in HUMANOID.config.vrm.items() if "Arm" in bone or "Hand" in bone]
    places[arms, 2] *= -1
    np.testing.assert_array_equal(measure(HUMANOID.config.vrm, places).rest, STILL)


def quarter_turns() -> list[np.ndarray]:
    """The 24 rotations of a cube."""
    signed = (
        np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product([1.0, -1.0], repeat=3)
    )
    return [turn for turn in signed if np.linalg.det(turn) > 0]


@pytest.mark.parametrize("metres", [unit[1] for unit in UNITS])
def test_every_quarter_turn_and_unit_is_put_right(metres: float) -> None:
    """Of the rest pose and the world together, or of the world alone (then the figure may face another way)."""
    places = PERSON.pose().positions
    for turn in quarter_turns():
        both = turned(PERSON, turn, turn, 1 / metres)
        made = righted(both, of_clip(both, HUMANOID.config.vrm))
        np.testing.assert_allclose(made.pose().positions, places, atol=1e-4, rtol=0)
        world = turned(PERSON, STILL, turn, 1 / metres)
        made = righted(world, of_clip(world, HUMANOID.config.vrm))
        np.testing.assert_allclose(made.pose().positions[..., 1], places[..., 1], atol=1e-4, rtol=0)


def test_turning_there_and_back_changes_nothing() -> None:
    there = turned(PERSON, QUARTER, SIDEWAYS)
    back = turned(there, QUARTER.T, SIDEWAYS.T)
    np.testing.assert_allclose(back.rotations, PERSON.rotations, atol=1e-6)
    np.testing.assert_allclose(back.root, PERSON.root, atol=1e-6)
    places = SIDEWAYS.astype(np.float32) @ PERSON.pose().positions[..., None]
    np.testing.assert_allclose(there.pose().positions, places[..., 0], atol=1e-5, rtol=0)
