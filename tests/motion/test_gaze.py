"""Eye contact: where the head points and the eyes look, in degrees; how long, and when they glance away."""

import numpy as np
import pytest
from tests.motion.viewer import eyes_off_viewer, off_viewer

from echoavatar.motion.action_overlay import Overlay
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.gaze import Gaze, turn_eyes, turn_head
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, SAMPLES_PER_FRAME

ALL = np.ones(8, np.float32)


def facing(yaw: float, pitch: float = 0.0, joint: str = "chest") -> MotionChunk:
    """A body that is turned there by one joint, degrees: to its left, and down."""
    rotations = np.zeros((8, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    half_yaw, half_pitch = np.radians([yaw, pitch]) / 2
    left = np.array([np.cos(half_yaw), 0, np.sin(half_yaw), 0])
    down = np.array([np.cos(half_pitch), np.sin(half_pitch), 0, 0])
    w, x, y, z = left[0] * down[0], left[0] * down[1], left[2] * down[0], -left[2] * down[1]
    rotations[:, HUMANOID.index(joint)] = [w, x, y, z]
    return MotionChunk(rotations, np.zeros((8, 3), np.float32), np.zeros((8, 52), np.float32))


def degrees_off(motion: MotionChunk) -> float:
    return float(np.degrees(off_viewer(motion)).max())


def with_head(motion: MotionChunk) -> MotionChunk:
    return turn_head(motion, ALL, 0 * ALL, HUMANOID)


def with_eyes(motion: MotionChunk) -> MotionChunk:
    return turn_eyes(motion, ALL, np.zeros((len(ALL), 2), np.float32), HUMANOID)


def look(motion: MotionChunk, way: str) -> float:
    """Degrees by which the left eye of our character turns: 30 at a curve of 1."""
    assert motion.face is not None
    return float(30 * motion.face[-1, ARKIT_NAMES.index(f"eyeLook{way}")])


@pytest.mark.parametrize(("yaw", "pitch"), [(30, 0), (-30, 0), (0, 25), (0, -20), (25, 15)])
def test_head_and_eyes_meet_the_viewer_between_them(yaw: float, pitch: float) -> None:
    """Of 30 degrees the head turns back 24, the eyes the other 6."""
    before = facing(yaw, pitch)
    head = with_head(before)
    assert degrees_off(head) == pytest.approx(0.2 * degrees_off(before), abs=0.1)
    eyes = with_eyes(head)
    sideways = look(eyes, "InLeft") - look(eyes, "OutLeft")  # to its right
    assert sideways == pytest.approx(look(eyes, "OutRight") - look(eyes, "InRight"))
    upwards = look(eyes, "UpLeft") - look(eyes, "DownLeft")
    assert np.hypot(sideways, upwards) == pytest.approx(degrees_off(head), abs=0.5)
    assert np.sign(sideways) == np.sign(yaw) or yaw == 0
    assert np.sign(upwards) == np.sign(pitch) or pitch == 0
    np.testing.assert_allclose(np.linalg.norm(eyes.rotations, axis=-1), 1, atol=1e-5)


def test_the_neck_takes_a_third_of_the_way() -> None:
    """Of the 24 degrees by which the head turns back."""
    turned = with_head(facing(30)).rotations[0, HUMANOID.index("neck")]
    assert 7 < np.degrees(2 * np.arccos(turned[0])) < 10


def test_eyes_that_meet_the_viewer_keep_a_third_of_their_own_movements() -> None:
    glance = facing(0)
    assert glance.face is not None
    glance.face[:, ARKIT_NAMES.index("eyeLookInLeft")] = 0.5
    assert 4 < look(with_eyes(glance), "InLeft") < 6  # of 15 degrees


def test_only_neck_head_and_eyes_move() -> None:
    before = facing(40)
    after = with_eyes(with_head(before))
    moved = np.abs(after.rotations - before.rotations).max((0, 2)) > 1e-6
    assert {name for name, has in zip(HUMANOID.names, moved, strict=True) if has} == {"neck", "head"}
    assert after.face is not None
    shapes = {ARKIT_NAMES[at] for at in np.flatnonzero(after.face.any(0))}
    assert shapes == {"eyeLookInLeft", "eyeLookOutRight"}


def test_a_neck_turns_so_far_and_nobody_looks_behind() -> None:
    """At 75 degrees the head turns by its most, at 180 not at all, and nothing jumps on the way there."""
    sides = [degrees_off(facing(yaw)) - degrees_off(with_head(facing(yaw))) for yaw in range(181)]
    assert max(sides) == pytest.approx(55, abs=0.5)
    assert sides[75] == pytest.approx(55, abs=0.5)
    assert sides[160] == pytest.approx(0, abs=0.01)
    assert np.abs(np.diff(sides)).max() < 2.5
    behind = with_eyes(facing(179))
    assert behind.face is not None
    assert behind.face.max() == pytest.approx(0, abs=1e-6)


def test_it_comes_and_goes_smoothly_and_a_chunk_made_again_is_the_same() -> None:
    gaze = Gaze()
    shares = [gaze.shares(chunk, is_wanted=2 <= chunk < 6) for chunk in range(12)]
    path = np.concatenate(shares)
    assert path[:16].max() == 0
    assert path[31:48].min() == 1  # half a second later
    assert path[72:].max() == 0
    assert 0.2 < path[23] < 0.8
    assert 0.2 < path[60] < 0.8
    assert np.abs(np.diff(path)).max() < 0.14
    assert np.array_equal(gaze.shares(3, is_wanted=True), shares[3])
    assert np.array_equal(gaze.shares(7, is_wanted=False), shares[7])


def test_a_nod_lowers_the_head_and_not_the_eyes() -> None:
    """15 degrees down on top: the head points there, the eyes look up by as much."""
    gaze = Gaze()
    nod = Overlay(("head",), np.tile(np.float32([np.radians(15), 0, 0]), (8, 1, 1)))
    for chunk in range(3):
        seen = gaze.apply(chunk, facing(0), HUMANOID, overlay=nod, heeds=True)
    assert degrees_off(seen) == pytest.approx(15, abs=0.1)
    assert look(seen, "UpLeft") == pytest.approx(15, abs=0.5)


def test_unwanted_it_changes_nothing() -> None:
    before = facing(20)
    assert Gaze().apply(0, before, HUMANOID, heeds=False) is before


def phrases(seconds: float, seed: int, level: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Noise in phrases of 1 to 4 seconds with pauses of 0.3 to 0.55 s, in whole chunks; and which frames hold sound."""
    draw, loud = np.random.default_rng(seed), []
    while len(loud) < seconds * 30:
        loud += [False] * int(draw.integers(9, 17)) + [True] * int(draw.integers(30, 120))
    said = np.array(loud[: len(loud) // CHUNK_FRAMES * CHUNK_FRAMES])
    sound = np.repeat(said, SAMPLES_PER_FRAME) * draw.normal(size=len(said) * SAMPLES_PER_FRAME) * level
    return sound.astype(np.float32), said


def looked(sound: np.ndarray, *, seed: int, contact: float = 0.5, heeds: bool = False) -> np.ndarray:
    """Degrees between the eyes and the viewer in each frame, of a body that is turned by 12 degrees and down by 8."""
    gaze, pose = Gaze(seed, contact), facing(12, 8)
    pieces = enumerate(sound.reshape(-1, CHUNK_SAMPLES))
    made = [gaze.apply(number, pose, HUMANOID, heeds=heeds, speech=piece) for number, piece in pieces]
    return np.degrees(eyes_off_viewer(MotionChunk(*map(np.concatenate, zip(*made, strict=True)))))


@pytest.mark.parametrize("contact", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("level", [0.3, 0.02])
def test_a_speakers_eyes_meet_the_viewer_for_their_share(contact: float, level: float) -> None:
    """Within 5 degrees, over six minutes, loud or soft; glances are seen, and nobody rolls the eyes."""
    sound, said = phrases(360, 1, level)
    off = looked(sound, seed=5, contact=contact)
    assert (off[said] < 5).mean() == pytest.approx(contact, abs=0.05)
    assert np.percentile(off, 99) < 25


@pytest.mark.parametrize("contact", [0.2, 0.5, 0.8])
def test_a_listeners_eyes_meet_the_viewer_for_half_as_much_again(contact: float) -> None:
    quiet = looked(
        np.zeros(360 * 24_000 // CHUNK_SAMPLES * CHUNK_SAMPLES, np.float32), seed=5, contact=contact, heeds=True
    )
    assert (quiet[60:] < 5).mean() == pytest.approx(min(1, 1.5 * contact), abs=0.05)


def test_eyes_that_shall_always_or_never_meet_the_viewer_do() -> None:
    sound, _ = phrases(60, 2)
    assert looked(sound, seed=1, contact=1.0)[30:].max() < 2
    assert looked(sound, seed=1, contact=0.0)[90:].min() > 5


def test_phrases_begin_with_a_glance_away_and_end_with_a_look() -> None:
    """Of those that begin in contact, two thirds; of other moments a third second holds one less often by far."""
    begin, chance, end = [], [], []
    for seed in range(4):
        sound, said = phrases(240, seed)
        away = looked(sound, seed=seed) >= 5
        starts = [at for at in np.flatnonzero(said[1:] & ~said[:-1]) + 1 if 30 < at < len(said) - 12]
        begin += [away[at : at + 10].any() for at in starts if not away[at - 1]]
        others = [at + 20 for at in starts if at + 30 < len(said) and said[at : at + 30].all()]
        chance += [away[at : at + 10].any() for at in others if not away[at - 1]]
        end += [not away[at + 8] for at in np.flatnonzero(~said[1:] & said[:-1]) + 1 if at + 8 < len(said)]
    assert 0.6 < np.mean(begin) < 0.9
    assert np.mean(chance) < 0.6 * np.mean(begin)
    assert np.mean(end) > 0.7


def test_glances_follow_from_seed_and_sound_alone_and_are_the_same_when_a_session_goes_back() -> None:
    sound, _ = phrases(20, 3)
    assert np.array_equal(looked(sound, seed=1), looked(sound, seed=1))
    assert not np.array_equal(looked(sound, seed=1), looked(sound, seed=2))
    gaze, pieces = Gaze(1), sound.reshape(-1, CHUNK_SAMPLES)
    first = [gaze.glances(number, piece, CHUNK_FRAMES) for number, piece in enumerate(pieces)]
    again = [gaze.glances(number, pieces[number], CHUNK_FRAMES) for number in range(30, len(pieces))]
    assert np.array_equal(np.stack(first[30:]), np.stack(again))


@pytest.mark.parametrize("yaw", [-60, -35, 35, 60])
def test_the_head_helps_a_speaker_whose_eyes_do_not_reach(yaw: int) -> None:
    """Eyes turn by 30 degrees; a head that is nearly there is left alone."""
    gaze, still = Gaze(1, 1.0), np.zeros(CHUNK_SAMPLES, np.float32)
    for number in range(4):
        made = gaze.apply(number, facing(yaw), HUMANOID, heeds=False, speech=still)
    assert degrees_off(made) < 30
    assert np.degrees(eyes_off_viewer(made)).max() < 2
    assert degrees_off(turn_head(facing(9), 0 * ALL, ALL, HUMANOID)) == pytest.approx(9, abs=0.01)
