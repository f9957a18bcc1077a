"""A standing body breathes, shifts its weight over planted feet, moves its head a little, and repeats exactly."""

import numpy as np
import pytest

from echoavatar.motion.idle_motion import LEGS, IdleMotion, breath, random_number, shift_weight
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import MotionOptions


def standing(frames: int = 8, **turns: tuple[float, float, float]) -> MotionChunk:
    """The rest pose, with joints turned about x, y or z by degrees (one axis each)."""
    rotations = np.zeros((frames, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    for name, turn in turns.items():
        half = np.radians(np.array(turn)) / 2
        rotations[:, HUMANOID.index(name)] = [np.cos(np.linalg.norm(half)), *np.sin(half)]
    root = np.tile(HUMANOID.offsets[0], (frames, 1)).astype(np.float32)
    return MotionChunk(rotations, root)


def positions(motion: MotionChunk) -> dict[str, np.ndarray]:
    turns = matrix_from_quaternion(motion.rotations)
    pose = forward_kinematics(HUMANOID, turns, motion.root)
    return {name: pose.positions[:, at] for at, name in enumerate(HUMANOID.names)}


def live(seconds: float, *, is_idle: bool = True, talks: float = 0.0, seed: int = 5, **options: bool) -> MotionChunk:
    idle, chunks = IdleMotion(seed, MotionOptions(**options)), range(round(seconds * 30 / 8))
    return join([idle.apply(chunk, standing(), HUMANOID, is_idle=is_idle, talks=talks) for chunk in chunks])


@pytest.mark.parametrize(
    "turns",
    [{}, {"hips": (0, 70, 0)}, {"leftUpperLeg": (-25, 0, 0), "leftLowerLeg": (40, 0, 0), "rightUpperLeg": (10, 0, 0)}],
    ids=["straight", "turned", "with a bent knee"],
)
def test_the_hips_go_to_the_left_and_the_feet_stay(turns: dict[str, tuple[float, float, float]]) -> None:
    before = standing(**turns)
    after = MotionChunk(before.rotations.copy(), before.root.astype(np.float64))
    legs = np.array([HUMANOID.index(name) for name in ("hips", *LEGS)])
    for rotations, root in zip(after.rotations, after.root, strict=True):
        shift_weight(rotations, root, HUMANOID.offsets, legs, 0.02, 0.0)
    after = after._replace(root=after.root.astype(np.float32))
    was, now = positions(before), positions(after)
    left = was["leftUpperLeg"][0] - was["rightUpperLeg"][0]
    went = (now["hips"] - was["hips"])[0]
    assert went @ (left / np.linalg.norm(left)) == pytest.approx(0.02, abs=0.002)
    for foot in ("leftFoot", "rightFoot", "leftToes", "rightToes"):
        assert np.linalg.norm(now[foot] - was[foot], axis=1).max() < 0.002


def test_a_standing_body_moves_and_its_feet_stay() -> None:
    """Hips go to and fro by centimetres, hands follow, the head turns by degrees; feet slide by less than a millimetre
    a second, and nothing is fast."""
    place = positions(live(60))
    hips = place["hips"] - place["hips"][0]
    assert 0.015 < np.ptp(hips[:, 0]) < 0.09
    assert np.ptp(place["leftHand"][:, 0]) > 0.015
    assert np.abs(hips[:, 2]).max() < 0.005
    for foot in ("leftFoot", "rightFoot"):
        assert np.linalg.norm(place[foot] - place[foot][0], axis=1).max() < 0.001
    fastest = max(np.linalg.norm(np.diff(place[name], axis=0), axis=1).max() * 30 for name in place)
    assert fastest < 0.15
    chest = place["upperChest"] - place["hips"]
    assert 0.005 < np.ptp(chest[:, 2]) < 0.02


@pytest.fixture(scope="module")
def two_minutes() -> MotionChunk:
    return live(120)


def degrees(motion: MotionChunk, *names: str) -> np.ndarray:
    """Rotation (t, 3) of these joints together, by axis; right for small angles."""
    rotations = motion.rotations.astype(np.float64)
    return np.asarray(np.degrees(2 * sum(rotations[:, HUMANOID.index(name), 1:] for name in names)))


def moves(path: np.ndarray, least: float) -> np.ndarray:
    """How long each movement of a path lasts that is faster than `least` a second, in seconds."""
    is_on = np.concatenate([[False], np.abs(np.diff(path)) * 30 > least, [False]])
    begins, ends = (np.flatnonzero(np.diff(is_on.astype(int)) == way) for way in (1, -1))
    return np.asarray((ends - begins) / 30)


def test_it_breathes_fourteen_times_a_minute_by_a_degree_of_the_shoulders(two_minutes: MotionChunk) -> None:
    rise = degrees(two_minutes, "leftShoulder")[:, 2]
    assert 1.0 < rise.max() < 1.6
    assert 26 <= np.count_nonzero((rise[1:] > 0.6) & (rise[:-1] <= 0.6)) <= 30


@pytest.mark.parametrize("off", [-0.17, -0.05, 0.06, 0.15])
def test_hips_that_lean_past_the_feet_come_back_over_them(off: float) -> None:
    """The feet are 17 cm apart: hips stay 6 cm to either side, and come to 11 cm where they were further."""
    body = standing(1)
    rotations, root = body.rotations[0], body.root[0].astype(np.float64)
    legs = np.array([HUMANOID.index(name) for name in ("hips", *LEGS)])
    start = root[0]
    shift_weight(rotations, root, HUMANOID.offsets, legs, off, 0.0)
    was = positions(MotionChunk(body.rotations.copy(), root[None].astype(np.float32)))
    shift_weight(rotations, root, HUMANOID.offsets, legs, 0.0, 1.0)
    now = positions(MotionChunk(body.rotations, root[None].astype(np.float32)))
    kept = (root[0] - start) / off
    assert kept > 0.97 if abs(off) < 0.07 else abs(root[0] - start) == pytest.approx(0.105, abs=0.015)
    for foot in ("leftFoot", "rightFoot", "leftToes", "rightToes"):
        assert np.linalg.norm(now[foot] - was[foot]) < 0.01


def test_a_talker_shifts_further_than_one_who_waits_and_a_calm_one_less(two_minutes: MotionChunk) -> None:
    waits, talks, calm = (
        np.ptp(x.root[:, 0]) for x in (two_minutes, *(live(120, is_idle=False, talks=t) for t in (1, 0.4)))
    )
    assert 0.16 < talks < 0.24
    assert 2.7 < talks / waits < 4.4
    assert 0.4 < calm / talks < 0.65


def test_it_shifts_its_weight_every_five_seconds_and_is_never_quite_still(two_minutes: MotionChunk) -> None:
    hips = two_minutes.root[:, 0]
    shifts = moves(hips, 0.01)
    assert 19 <= len(shifts) <= 25
    assert 0.8 < np.median(shifts) < 1.3  # of 1.6 s, the part over a centimetre a second
    assert 0.045 < np.ptp(hips) < 0.07
    assert 0.0012 < np.median(np.abs(np.diff(hips))) * 30 < 0.0035


def test_it_looks_about_by_some_degrees_and_ahead_in_between(two_minutes: MotionChunk) -> None:
    yaw = degrees(two_minutes, "neck", "head")[:, 1]
    looks = moves(yaw, 0.003)
    assert 18 <= len(looks) <= 27
    assert 0.8 < np.median(looks) < 1.0
    assert 7 < np.abs(yaw).max() < 9.2
    assert 0.25 < np.mean(np.abs(yaw) < 0.05) < 0.55
    pitch = degrees(two_minutes, "neck", "head")[:, 0] + degrees(two_minutes, "spine", "chest", "upperChest")[:, 0]
    assert 5 < np.ptp(pitch) < 9


def test_a_talkers_head_turns_nods_and_tilts_further_and_a_calm_ones_less(two_minutes: MotionChunk) -> None:
    talks, calm = (degrees(live(120, is_idle=False, talks=share), "neck", "head") for share in (1.0, 0.4))
    for axis, least, most in ((0, 10, 18), (1, 14, 19), (2, 9, 13)):
        assert least < np.abs(talks[:, axis]).max() < most
        assert 0.35 < np.ptp(calm[:, axis]) / np.ptp(talks[:, axis]) < 0.55
    assert np.abs(degrees(two_minutes, "neck", "head")[:, 2]).max() < 2.5
    assert np.abs(np.diff(talks, axis=0)).max() * 30 < 80


def test_a_talkers_head_stays_in_a_short_pause_and_goes_back_in_a_long_one() -> None:
    """After 20 s of talk, half a second and eight seconds of silence."""

    def turned(until: int, chunk: int) -> np.ndarray:
        """Degrees in this chunk of one who talks before chunk `until`."""
        idle = IdleMotion(5)
        made = [idle.apply(c, standing(), HUMANOID, is_idle=False, talks=float(c < until)) for c in range(chunk + 1)]
        return degrees(made[-1], "neck", "head")

    for chunk, least, most in ((76, 0.85, 1.0), (105, 0.0, 0.06)):
        breathes, talks = turned(0, chunk), turned(chunk + 1, chunk)
        assert np.linalg.norm(talks - breathes, axis=1).min() > 1
        kept = np.linalg.norm(turned(75, chunk) - breathes) / np.linalg.norm(talks - breathes)
        assert least < kept < most


def test_it_leans_slowly_to_all_sides_and_is_seldom_upright(two_minutes: MotionChunk) -> None:
    aside = degrees(two_minutes, "spine", "chest", "upperChest")[:, 2]
    leans = moves(aside, 0.003)
    assert 20 <= len(leans) <= 27
    assert 2.0 < np.median(leans) < 2.6
    assert 1.5 < np.abs(aside).max() < 3.1
    assert 0.06 < np.mean(np.abs(aside) < 0.05) < 0.25


def test_a_body_that_dances_stands_over_its_feet_in_two_seconds_and_idles_again_in_two() -> None:
    """Four seconds alone, five with a dance, four alone again."""
    idle, witness = IdleMotion(5), live(16)
    motion = join([idle.apply(chunk, standing(), HUMANOID, is_idle=not 20 <= chunk < 40) for chunk in range(60)])
    hips = motion.root[:, 0]
    assert np.abs(hips[160:163]).min() > 0.02
    assert np.abs(hips[175]) > 0.01
    assert np.abs(hips[220:320]).max() < 1e-3
    behind = np.abs(hips - witness.root[:, 0])[320:]
    assert behind[8] > 0.7 * np.abs(witness.root[328, 0])
    assert behind[60:].max() < 1e-3
    leans = degrees(motion, "spine")[:, 0] - degrees(live(16, is_idle=False), "spine")[:, 0]
    assert np.abs(leans[176:320]).max() < 1e-3


def test_only_breath_goes_on_beside_a_dance() -> None:
    motion = live(20, is_idle=False)
    place = positions(motion)
    late = slice(60, None)
    assert np.ptp(place["hips"][late], axis=0).max() < 1e-6
    turned = np.abs(motion.rotations[late] - motion.rotations[60]).max((0, 2)) > 1e-6
    moved = {name for name, has in zip(HUMANOID.names, turned, strict=True) if has}
    assert moved == {"spine", "chest", "upperChest", "neck", "head", "leftShoulder", "rightShoulder"}
    assert np.degrees(4 * np.abs(motion.rotations[:, HUMANOID.index("head"), 1:]).max()) < 2


@pytest.mark.parametrize("option", ["in_place", "upper_body"])
def test_hips_that_may_not_move_do_not(option: str) -> None:
    assert np.ptp(live(30, **{option: True}).root, axis=0).max() == 0


def test_a_chunk_that_is_made_again_is_the_same_and_seeds_differ() -> None:
    idle = IdleMotion(3)
    first = [idle.apply(chunk, standing(), HUMANOID, is_idle=chunk != 3) for chunk in range(8)]
    again = [idle.apply(chunk, standing(), HUMANOID, is_idle=chunk != 3) for chunk in range(4, 8)]
    for one, other in zip(first[4:], again, strict=True):
        np.testing.assert_array_equal(one.rotations, other.rotations)
        np.testing.assert_array_equal(one.root, other.root)
    assert np.abs(live(20, seed=1).root - live(20, seed=2).root).max() > 0.003


def test_nothing_jumps_when_sound_comes_and_goes() -> None:
    idle = IdleMotion(4)
    motion = join([idle.apply(c, standing(), HUMANOID, is_idle=(c // 6) % 2 == 0) for c in range(120)])
    speed = np.linalg.norm(np.diff(positions(motion)["head"], axis=0), axis=1) * 30
    assert speed.max() < 0.2
    jump = np.abs(np.diff(motion.root, n=2, axis=0)).max()
    assert jump < 0.0015


def test_breath_goes_in_quicker_than_out() -> None:
    full = np.array([breath(frame / 30, np.uint64(0)) for frame in range(126)])
    assert full.min() == 0
    assert full.max() == pytest.approx(1, abs=0.01)
    rising = (np.diff(full) > 0).mean()
    assert 0.3 < rising < 0.5


def test_numbers_are_spread_evenly_and_do_not_repeat() -> None:
    drawn = np.array([random_number(np.uint64(seed), 1, place) for seed in range(20) for place in range(100)])
    assert abs(drawn.mean() - 0.5) < 0.03
    assert np.histogram(drawn, 10, (0, 1))[0].min() > 140
    assert len(np.unique(drawn)) == len(drawn)
    assert abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1]) < 0.07
