"""A hand that hardly moves rests, also beside one that works; one that gestures is hardly late."""

from copy import deepcopy

import numpy as np
import pytest
from tests.motion.stages.poses import everyone

from echoavatar.motion.kinematics import HUMANOID, Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_axis_angle
from echoavatar.motion.stages.pose import Pose
from echoavatar.motion.stages.stillness import Stillness

ARMS = HUMANOID.indices(("leftLowerArm", "rightLowerArm"))
TIME = np.arange(240) / 30


def forearms(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(1, t, j, 4): each forearm turned by so many radians about an axis across it; everything else at rest."""
    turns = np.zeros((1, len(left), HUMANOID.joints, 3), np.float32)
    turns[:, :, ARMS, 1] = np.stack([left, right], 1)
    return quaternion_from_axis_angle(turns)


def shown(
    rotations: np.ndarray,
    skeleton: Skeleton = HUMANOID,
    travel: float = 0.0,
    size: float = 1.0,
    until: int = 10**6,
    talks: float = 0.0,
) -> np.ndarray:
    """What is shown in chunks of 8 frames; hips travel by so many metres per second, arms have this size at first."""
    stage, rotations = Stillness(skeleton), rotations.copy()
    state = stage.init_state(len(rotations))
    for at in range(0, rotations.shape[1], 8):
        part = np.ascontiguousarray(rotations[:, at : at + 8])
        root = np.full((*part.shape[:2], 3), (0, 0.9, travel / 30), np.float32)
        own = size if at < until else 1.0
        hands = np.tile(np.float32([own, own, talks]), (len(part), 1))
        stage.step(Pose(part, root, 30.0), state, everyone(len(part)), hands)
        rotations[:, at : at + 8] = part
    return rotations


def trunk_sway(hands: np.ndarray, travel: float = 0.0, pace: float = 5.0) -> float:
    """Radians that the spine's sway of 0.1 spans when shown, beside hands that turn like this; `pace` per second."""
    moves, sway = forearms(hands, hands), np.zeros((1, len(TIME), 3), np.float32)
    sway[0, :, 0] = 0.05 * np.sin(pace * TIME)
    moves[:, :, HUMANOID.index("spine")] = quaternion_from_axis_angle(sway)
    made = shown(moves, travel=travel)[0, 120:, HUMANOID.index("spine")]
    return float(np.ptp(2 * np.arctan2(made[:, 1], made[:, 0])))


def test_the_trunk_takes_part_while_hands_work_and_is_calm_while_they_rest():
    works, rests = trunk_sway(0.8 * np.sin(8 * TIME)), trunk_sway(0 * TIME)
    assert 0.1 < works < 0.21
    assert 0.01 < rests < 0.04, "it still breathes"
    assert trunk_sway(0 * TIME, travel=0.5) == pytest.approx(0.1, abs=0.015), "a dancer's trunk passes"


def test_a_trunk_does_not_shake_with_hands_that_work():
    """At 4 Hz, which people's trunks hardly have; a dancer's passes."""
    hands = 0.8 * np.sin(8 * TIME)
    assert trunk_sway(hands, pace=25) < 0.1
    assert trunk_sway(hands, travel=0.5, pace=25) == pytest.approx(0.1, abs=0.015)


def test_a_trunk_that_turns_beside_resting_hands_gets_there():
    turn = np.zeros((1, len(TIME), 3), np.float32)
    turn[0, :, 1] = 0.4 * np.clip(TIME, 0, 1)
    moves, spine = forearms(0 * TIME, 0 * TIME), HUMANOID.index("spine")
    moves[:, :, spine] = quaternion_from_axis_angle(turn)
    made = shown(moves)[0, :, spine]
    assert 2 * np.arctan2(made[-1, 2], made[-1, 0]) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(
    ("roll", "travel", "least", "most"), [(0.1, 0, 0.08, 0.1), (0.7, 0, 0.2, 0.26), (-0.7, 1, 0.65, 0.7)]
)
def test_who_talks_leans_a_little_to_a_side_and_who_dances_as_far_as_he_likes(roll, travel, least, most):
    turns, bones = np.zeros((1, len(TIME), 3), np.float32), HUMANOID.indices(("spine", "chest", "upperChest"))
    turns[0, :, 2] = roll / 3
    moves = forearms(0 * TIME, 0 * TIME)
    moves[:, :, bones] = quaternion_from_axis_angle(turns)[:, :, None]
    made = shown(moves, travel=travel)[0, -1, bones]
    assert least <= abs(2 * np.arctan2(made[:, 3], made[:, 0]).sum()) <= most + 1e-5


def angles(rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radians of both forearms in every frame."""
    turned = 2 * np.arctan2(rotations[0][:, ARMS, 2], rotations[0][:, ARMS, 0])
    return turned[:, 0], turned[:, 1]


def test_a_hand_that_trembles_comes_to_rest_and_one_that_sinks_arrives():
    """4 degrees to and fro; a hand that sinks by 30 degrees in two seconds is nearly there two seconds later."""
    trembling, sinking = 0.07 * np.sin(9 * TIME), 0.52 * np.clip(TIME / 2, 0, 1)
    left, right = angles(shown(forearms(trembling, sinking)))
    assert np.ptp(left[60:]) < 0.35 * np.ptp(trembling)
    assert right[120] == pytest.approx(0.52, abs=0.1)
    assert right[-1] == pytest.approx(0.52, abs=0.035)


@pytest.mark.parametrize("side", [0, 1])
def test_a_stroke_is_on_time(side: int):
    """A forearm turns by 60 degrees in a third of a second, from any frame of a chunk on: 50 ms late on average."""
    late = []
    for start in range(60, 68):
        stroke = 1.05 * np.clip((TIME - start / 30) * 3, 0, 1) * (TIME < 4)
        moves = (stroke, 0 * stroke) if side == 0 else (0 * stroke, stroke)
        made = angles(shown(forearms(*moves)))
        late.append((made[side] > 0.52).argmax() - (stroke > 0.52).argmax())
        assert made[side].max() > 0.95
        assert np.abs(made[1 - side]).max() < 1e-6, "the other hand does not move"
    assert np.mean(late) <= 1.5
    assert max(late) <= 2


def test_beside_a_talkers_hand_that_works_the_other_rests_more():
    """The same slow sway of the left hand, alone and beside strokes of the right one."""
    sway, strokes = 0.2 * np.sin(4 * TIME), 0.6 * np.sin(8 * TIME)
    alone, _ = angles(shown(forearms(sway, 0 * sway), talks=1))
    beside, works = angles(shown(forearms(sway, strokes), talks=1))
    assert np.ptp(beside[60:]) < 0.65 * np.ptp(alone[60:])
    assert np.ptp(works[60:]) > 0.9 * np.ptp(strokes)


@pytest.mark.parametrize(("talks", "least"), [(0, 0.9), (1, 0.4)])
def test_two_hands_that_work_both_work_and_a_talkers_less(talks: float, least: float):
    strokes = 0.6 * np.sin(8 * TIME)
    for made in angles(shown(forearms(strokes, strokes), talks=talks)):
        assert np.ptp(made[60:]) > least * np.ptp(strokes)


def test_the_arms_of_a_dancer_pass():
    """The same sway, of one who stands and of one whose hips travel by half a metre per second."""
    sway = 0.2 * np.sin(4 * TIME)
    stands, dances = (angles(shown(forearms(sway, sway), travel=speed))[0] for speed in (0.05, 0.5))
    assert np.ptp(stands[60:]) < 0.6 * np.ptp(sway)
    assert np.ptp(dances[60:]) > 0.85 * np.ptp(sway)
    assert np.ptp(dances[30:60]) > 0.85 * np.ptp(sway[30:60]), "from the second second on"
    first = angles(shown(forearms(sway, sway), travel=0.5))[0][:12]
    assert np.ptp(first) < 0.9 * np.ptp(sway[:12]), "one step does not make a dancer"


def test_rows_alone_and_together_show_the_same():
    moves = forearms(0.2 * np.sin(4 * TIME), 0.6 * np.sin(8 * TIME))
    other = forearms(0.5 * np.sin(3 * TIME), 0 * TIME)
    assert np.array_equal(shown(np.concatenate([other, moves]))[1:], shown(moves))


def test_a_row_that_is_not_active_keeps_its_state_and_its_pose():
    stage = Stillness(HUMANOID)
    state, moves = stage.init_state(1), forearms(0.2 * np.sin(4 * TIME), 0 * TIME)
    stage.step(Pose(moves[:, :8].copy(), np.zeros((1, 8, 3), np.float32), 30.0), state, everyone(1))
    before, part = deepcopy(state), moves[:, 60:68].copy()
    stage.step(Pose(part, np.zeros((1, 8, 3), np.float32), 30.0), state, ~everyone(1))
    assert np.array_equal(part, moves[:, 60:68])
    assert all(bool((now == then).all()) for now, then in zip(state.arrays(), before.arrays(), strict=True))


def test_a_rig_without_arms_is_left_as_it_is():
    names = [name.replace("LowerArm", "Elbow") for name in HUMANOID.names]
    config = HUMANOID.config.model_copy(update={"names": tuple(names), "tips": {}})
    moves = forearms(0.2 * np.sin(4 * TIME), 0 * TIME)
    assert np.array_equal(shown(moves, skeleton=Skeleton(config)), moves)


@pytest.mark.parametrize(("size", "least", "most"), [(0.4, 0.33, 0.48), (1.25, 1.15, 1.3)])
def test_a_speaker_who_gestures_less_or_more_makes_smaller_or_larger_strokes_at_the_same_time(size, least, most):
    moves = forearms(0.5 * np.sin(6 * TIME), 0.5 * np.sin(6 * TIME))
    own, asked = (angles(shown(moves, size=one))[0][120:] for one in (1.0, size))
    assert least < np.ptp(asked) / np.ptp(own) < most
    lag = np.argmax([np.dot(own[8:-8], asked[8 + by : len(asked) - 8 + by]) for by in range(-8, 9)]) - 8
    assert abs(lag) <= 1


def test_a_new_size_is_reached_within_two_chunks_and_without_a_jump():
    moves = forearms(0.5 * np.sin(6 * TIME), 0 * TIME)
    own, changed = angles(shown(moves))[0], angles(shown(moves, size=0.4, until=120))[0]
    assert np.abs(changed - own)[136:].max() < 0.03 < np.abs(changed - own)[100:120].max()
    assert np.abs(np.diff(changed)).max() < 1.6 * np.abs(np.diff(own)).max()


def test_a_small_gesturers_hand_reaches_a_new_place_within_seconds():
    """The left arm is lifted sideways, or falls; three seconds later it has gone so much of the way."""

    def gone(first: float, last: float) -> float:
        turns, arm = np.zeros((1, len(TIME), 3), np.float32), HUMANOID.index("leftUpperArm")
        turns[0, :, 2] = np.where(TIME < 4, first, last)
        moves = forearms(0 * TIME, 0 * TIME)
        moves[:, :, arm] = quaternion_from_axis_angle(turns)
        made = shown(moves, size=0.4)[0, :, arm]
        angle = 2 * np.arctan2(made[:, 3], made[:, 0])
        return float((angle[210] - first) / (last - first))

    assert 0.8 < gone(-1.2, 0.2) < 0.95
    assert 0.8 < gone(0.2, -1.2) < 0.95


@pytest.mark.parametrize(("talks", "travel", "least", "most"), [(0, 0, 0.98, 1), (1, 0, 0.6, 0.9), (1, 0.5, 0.98, 1)])
def test_a_talkers_hand_that_is_held_out_before_the_body_is_lowered_and_a_dancers_is_not(talks, travel, least, most):
    turns, arm = np.zeros((1, len(TIME), 3), np.float32), HUMANOID.index("leftUpperArm")
    turns[0, :, 1] = -1.2  # to the front
    moves = forearms(0 * TIME, 0 * TIME)
    moves[:, :, arm] = quaternion_from_axis_angle(turns)
    made = shown(moves, talks=talks, travel=travel)[0, -1]
    poses = (matrix_from_quaternion(q) for q in (moves[0, -1], made))
    places = [forward_kinematics(HUMANOID, pose, np.zeros(3)).positions for pose in poses]
    was, now = (place[HUMANOID.index("leftHand")] - place[arm] for place in places)
    assert least <= now[2] / was[2] <= most
    assert now[1] <= was[1] + 1e-4
    assert now[0] >= was[0] - 1e-4, "aside"


def test_a_talkers_strokes_to_the_front_keep_their_length():
    """The hand as a whole comes nearer, by its mean place."""
    turns, arm = np.zeros((1, len(TIME), 3), np.float32), HUMANOID.index("leftUpperArm")
    turns[0, :, 1] = -0.9 + 0.3 * np.sin(6 * TIME)
    moves = forearms(0 * TIME, 0 * TIME)
    moves[:, :, arm] = quaternion_from_axis_angle(turns)

    def ahead(body: np.ndarray) -> np.ndarray:
        place = forward_kinematics(HUMANOID, matrix_from_quaternion(body[0]), np.zeros(3)).positions
        return np.asarray((place[:, HUMANOID.index("leftHand")] - place[:, arm])[120:, 2])

    before, after = (ahead(shown(moves, talks=talks)) for talks in (0.0, 1.0))
    assert after.mean() < 0.92 * before.mean()
    assert 1 < np.ptp(after) / np.ptp(before) < 1.3


@pytest.mark.parametrize(("talks", "wider"), [(0, 0.0), (1, 0.08)])
def test_a_talkers_feet_stand_further_apart_and_flat_and_a_dancers_as_they_are(talks: float, wider: float) -> None:
    turns, thigh, knee = (
        np.zeros((1, 30, HUMANOID.joints, 3), np.float32),
        *HUMANOID.indices(("leftUpperLeg", "leftLowerLeg")),
    )
    turns[:, :, thigh, 0], turns[:, :, knee, 0] = -0.5, 0.8  # one knee is bent
    body = quaternion_from_axis_angle(turns)
    before, after = (matrix_from_quaternion(q) for q in (body[0, -1], shown(body, talks=talks)[0, -1]))
    was, now = (forward_kinematics(HUMANOID, pose, np.zeros(3)) for pose in (before, after))
    feet = HUMANOID.indices(("leftFoot", "rightFoot"))
    apart = [place.positions[feet[0], 0] - place.positions[feet[1], 0] for place in (was, now)]
    assert apart[1] - apart[0] == pytest.approx(wider, abs=0.012)
    np.testing.assert_allclose(now.rotations[list(feet)], was.rotations[list(feet)], atol=1e-4)
